"""A group's adequacy over the wire."""

from typing import Literal

from pydantic import BaseModel, Field

from app.diary.adequacy import Reason
from app.http.field_descriptions import NUMBER
from app.nutrition.intakes.life_stage import LifeStage
from app.nutrition.intakes.reference_intakes import Per


class VariancesOut(BaseModel):
    """Variance components on the scale of analysis."""

    scale: Literal["as_is", "square_root", "cube_root", "fourth_root", "logarithm"] = Field(
        description="The scale on which the days of the group were analysed, chosen so that they are nearest to normal."
    )
    within: float = Field(description="Of a person's days.")
    between: float = Field(description="Of persons' usual intakes.")


class StageAdequacyOut(BaseModel):
    """A life stage's group; `reason` says why no share is told."""

    life_stage: LifeStage = Field(
        description="The group by age, sex, pregnancy and lactation, as the reference intakes have it."
    )
    persons: int = Field(description="Participants whose days were used.")
    days: int = Field(description="Closed days that were used.")
    days_left_out: int = Field(description="Closed days of which too little is known.")
    ear: float | None = Field(
        description="Estimated Average Requirement in the component's unit, per `per`; null: the source sets none."
    )
    per: Per | None = Field(
        description="Whether `ear` and the intakes are per day, or per day and kilogram of body weight; null: there "
        "is no reference."
    )
    compared_with: str | None = Field(
        description="Which component is compared with the EAR, and what to mind; null: there is no reference."
    )
    mean_usual_intake: float | None = Field(
        description="Mean of the group's usual intakes, in the unit of `ear`; null where `reason` says why."
    )
    share_below_ear: float | None = Field(
        description="Share of the group whose usual intake lies below the EAR, 0 to 1; null where `reason` says why."
    )
    share_interval: tuple[float, float] | None = Field(description="90 %, over persons and the adjustment.")
    unadjusted_share: float | None = Field(description="Of bare means of days: biased, shown to compare.")
    variances: VariancesOut | None = Field(
        description="Variance within and between persons; null where `reason` says why."
    )
    reason: Reason | None = Field(description="Why there is no share; null: there is one.")


class AdequacyOut(BaseModel):
    """The share of each group whose usual intake lies below the EAR."""

    number: str = Field(description=NUMBER)
    tagname: str | None = Field(description="INFOODS tagname, such as VITC; null: there is none.")
    name: str = Field(description="The component's name.")
    unit: str = Field(description="Unit of the amounts.")
    groups: list[StageAdequacyOut] = Field(description="One entry per life stage that has participants.")
    persons_without_stage: int = Field(description="Left out: their profile does not tell the life stage, or a weight.")
    method: str = Field(description="How the shares were computed, with the sources, for a paper's methods section.")
