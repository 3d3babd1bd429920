"""Foods into the search index: the words they are found by, how well, and the trigrams that mistyped words meet by."""

from collections.abc import Iterator, Mapping, Sequence

from sqlalchemy.orm import Session

from app.foods.models import Food
from app.foods.search import queries as food_index
from app.nutrition.search import posting_ranks
from app.nutrition.words import trigrams

_KINDS = frozenset({"fdc_data_type", "sr28_figures"})  # among source ids: which data set a food is of


def index_foods(session: Session, rows: Sequence[Food]) -> None:
    """Add these foods' names and aliases to the index; they must have their ids."""
    ranks = [
        (row, posting_ranks(row.name, other_names(row.aliases, row.source_ids), row.food_group, row.state))
        for row in rows
    ]
    typed = {word for _, of_words in ranks for word in of_words if not word.endswith("*") and not word.isdigit()}
    missing = sorted(typed - food_index.known_words(session, typed))
    food_index.add_words(session, [(word, trigrams(word)) for word in missing])
    food_index.add_postings(session, ranks)


def other_names(aliases: Sequence[str], source_ids: Mapping[str, object]) -> Iterator[str]:
    """The labels that a food goes by beside its name: what a source calls it stands among the source's ids."""
    yield from aliases
    for system, name in source_ids.items():
        if is_name(system):
            yield str(name)


def is_name(system: str) -> bool:
    """Whether what stands under this system among a food's source ids is a name for a person, no code."""
    return system.endswith("_name")


def is_code(system: str) -> bool:
    """Whether what stands under this system is a number of this very food: no name, no kind, no relative's."""
    return not is_name(system) and system not in _KINDS
