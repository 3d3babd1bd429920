"""HTTP schemas of a study's adequacy."""

from typing import Literal

from pydantic import BaseModel, Field

from app.diary.adequacy import Reason
from app.http.field_descriptions import NUMBER
from app.nutrition.intakes.life_stage import LifeStage
from app.nutrition.intakes.reference_intakes import Per


class VariancesOut(BaseModel):
    """Variance components on the scale of analysis."""

    scale: Literal["as_is", "square_root", "cube_root", "fourth_root", "logarithm"] = Field(
        description="The scale on which the group's days are closest to normally distributed, used for the analysis."
    )
    within: float = Field(description="Variance of a person's days.")
    between: float = Field(description="Variance of usual intakes between persons.")


class StageAdequacyOut(BaseModel):
    """The result of one life stage; `reason` tells why there is no share."""

    life_stage: LifeStage = Field(
        description="The group by age, sex, pregnancy and lactation, as the reference intakes define it."
    )
    persons: int = Field(description="Participants whose days were used.")
    days: int = Field(description="Closed days that were used.")
    days_left_out: int = Field(
        description="Closed days that are not measured and final, or whose coverage is too low."
    )
    ear: float | None = Field(
        description="Estimated Average Requirement in the component's unit, per `per`; null: the source sets none."
    )
    per: Per | None = Field(
        description="Whether `ear` and the intakes are per day, or per day and kilogram of body weight; null: there "
        "is no reference."
    )
    compared_with: str | None = Field(
        description="The component that is compared with the EAR, and caveats; null: there is no reference."
    )
    mean_usual_intake: float | None = Field(
        description="Mean of the group's usual intakes, in the unit of `ear`; null if there is a `reason`."
    )
    share_below_ear: float | None = Field(
        description="Share of the group whose usual intake is below the EAR, 0 to 1; null if there is a `reason`."
    )
    share_interval: tuple[float, float] | None = Field(
        description="90 % interval of the share, over persons and the adjustment."
    )
    unadjusted_share: float | None = Field(
        description="Share from plain means of days: biased, for comparison."
    )
    variances: VariancesOut | None = Field(
        description="Variance within and between persons; null if there is a `reason`."
    )
    reason: Reason | None = Field(description="Why there is no share; null: there is one.")


class AdequacyOut(BaseModel):
    """The share of each group whose usual intake lies below the EAR."""

    number: str = Field(description=NUMBER)
    tagname: str | None = Field(description="INFOODS tagname, such as VITC; null: there is none.")
    name: str = Field(description="The component's name.")
    unit: str = Field(description="Unit of the amounts.")
    groups: list[StageAdequacyOut] = Field(
        description="One entry per life stage that has participants."
    )
    persons_without_stage: int = Field(
        description="Participants left out because their life stage, or a weight it needs, is unknown."
    )
    method: str = Field(
        description="How the shares were computed, with the sources, for a paper's methods section."
    )
