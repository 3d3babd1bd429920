"""Add foods to the search index: their words with ranks, and the trigrams that find mistyped words."""

from collections.abc import Iterator, Mapping, Sequence

from sqlalchemy.orm import Session

from app.foods.models import Food
from app.foods.search import queries as food_index
from app.nutrition.search import posting_ranks
from app.nutrition.words import trigrams

_KINDS = frozenset({"fdc_data_type", "sr28_figures"})  # source ids that name a food's data set


def index_foods(session: Session, rows: Sequence[Food]) -> None:
    """Add these foods' names and aliases to the index; the rows must have ids."""
    ranks = [
        (
            row,
            posting_ranks(
                row.name, other_names(row.aliases, row.source_ids), row.food_group, row.state
            ),
        )
        for row in rows
    ]
    new_words = {
        word
        for _, by_word in ranks
        for word in by_word
        if not word.endswith("*") and not word.isdigit()
    }
    missing = sorted(new_words - food_index.indexed_words(session, new_words))
    food_index.add_words(session, [(word, trigrams(word)) for word in missing])
    food_index.add_postings(session, ranks)


def other_names(aliases: Sequence[str], source_ids: Mapping[str, object]) -> Iterator[str]:
    """Yield a food's labels beside its name: aliases, and names in sources, which are stored with the source ids."""
    yield from aliases
    for system, name in source_ids.items():
        if is_name(system):
            yield str(name)


def is_name(system: str) -> bool:
    """Return whether the source id of this system is a display name, not a code."""
    return system.endswith("_name")


def is_code(system: str) -> bool:
    """Return whether the source id of this system is a code of this food, not a name or a data set."""
    return not is_name(system) and system not in _KINDS
