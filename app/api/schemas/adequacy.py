"""A group's adequacy over the wire."""

from typing import Literal

from pydantic import BaseModel, Field


class VariancesOut(BaseModel):
    """Variance components on the scale of analysis."""

    scale: Literal["as_is", "square_root", "cube_root", "fourth_root", "logarithm"]
    within: float = Field(description="Of a person's days.")
    between: float = Field(description="Of persons' usual intakes.")


class StageAdequacyOut(BaseModel):
    """A life stage's group; `reason` says why no share is told."""

    life_stage: str
    persons: int
    days: int
    days_left_out: int = Field(description="Closed days of which too little is known.")
    ear: float | None
    per: Literal["day", "kg_day"] | None
    compared_with: str | None
    mean_usual_intake: float | None
    share_below_ear: float | None
    share_interval: tuple[float, float] | None = Field(description="90 %, over persons and the adjustment.")
    unadjusted_share: float | None = Field(description="Of bare means of days: biased, shown to compare.")
    variances: VariancesOut | None
    reason: (
        Literal[
            "energy_follows_need",
            "no_ear",
            "need_is_skewed",
            "intake_is_lower_bound",
            "too_few_persons",
            "no_repeated_days",
            "no_difference_between_persons",
        ]
        | None
    )


class AdequacyOut(BaseModel):
    """The share of each group whose usual intake lies below the EAR."""

    number: str
    tagname: str | None
    name: str
    unit: str
    groups: list[StageAdequacyOut]
    persons_without_stage: int = Field(description="Left out: their profile does not tell the life stage, or a weight.")
    method: str
