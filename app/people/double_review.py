"""The part of a study's protocol that says which items two reviewers decide without seeing each other."""

from pydantic import Field

from app.http.closed_model import ClosedModel
from app.http.text_schemas import Number, Text


class ReviewStratum(ClosedModel):
    """Items of a food group, or of all, and of a least doubt."""

    food_group: Text | None = Field(
        default=None, max_length=100, description="As in `GET /v1/food-groups`; null: all."
    )
    min_doubt: Number = Field(default=0, ge=0, le=1, description="As in the review queue.")
    share: Number = Field(ge=0, le=1, description="Share of these items that is drawn.")


class DoubleReview(ClosedModel):
    """Which items two reviewers decide, and from which difference on a third settles them."""

    seed: int = Field(ge=0, le=2**31 - 1, description="The same seed draws the same items.")
    share: Number = Field(ge=0, le=1, description="Share of the items of no stratum.")
    strata: list[ReviewStratum] = Field(
        default=[], max_length=50, description="The first that an item belongs to counts."
    )
    limit_percent: Number = Field(
        ge=0,
        le=200,
        description="Two decisions of the same food agree if their grams, and so their energy, differ by no more "
        "per cent of their mean.",
    )
    known_share: Number = Field(
        default=0,
        ge=0,
        le=0.5,
        description="Share of a reviewer's items that have a known answer, while there are new ones.",
    )
