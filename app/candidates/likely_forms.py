"""Probable forms of a food by its looks: the candidates of an index, each as its kind usually lies.

A description and an index's file -> probability of each form; what the index does not know is left over.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from app.core.errors import InvalidInputError
from app.identification.food_index import open_index
from app.identification.identifier import Identifier
from app.identification.metric import Vectors
from app.nutrition.foods import load_starter_table
from app.vision.looks.vcm import VCM_VERSION

WHOLE = frozenset({"whole", "lying"})


@cache
def identifier_of(index: Path | None, none_prior: float | None = None) -> Identifier:
    """Return the identifier of an index's file, kept for the process; None: of the shipped one.

    Raises InvalidInputError, code `food_index_unreadable`.
    """
    return Identifier(open_index(index), none_prior=none_prior)


def form_index_version(index: Path | None) -> str | None:
    """Return the version of the index that likely_forms uses; None if it cannot, and then no meal fails by it."""
    try:
        opened = open_index(index)
    except InvalidInputError:
        return None
    return opened.version if opened.vcm_version == VCM_VERSION else None


def likely_forms(vector: Vectors, index: Path | None) -> Mapping[str, float]:
    """Return the probability of each form of a food, by its description (d,). They may sum to less than 1.

    Foods of another form than `whole`, `slab` and `heap`, and those that the starter table lacks, say nothing; neither
    does an index that cannot be read. Raises ValueError if the vector is not finite.
    """
    shares: dict[str, float] = {}
    if form_index_version(index) is None:
        return shares
    forms = _usual_forms()
    for candidate in (
        identifier_of(index).identify(vector, most=len(open_index(index).foods)).candidates
    ):
        form = forms.get(candidate.food_key)
        if form is not None:
            kept = "whole" if form in WHOLE else form
            shares[kept] = shares.get(kept, 0.0) + candidate.probability
    return shares


@cache
def _usual_forms() -> Mapping[str, str | None]:
    return {food.key: food.form for food in load_starter_table().foods}
