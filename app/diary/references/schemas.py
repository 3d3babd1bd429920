"""Agreement with a reference over the wire."""

from pydantic import BaseModel, ConfigDict, Field


class FigureOut(BaseModel):
    """A figure with its 95 % interval."""

    model_config = ConfigDict(from_attributes=True)

    value: float
    low: float
    high: float


class NutrientAgreementOut(BaseModel):
    """How far participants' means of a nutrient agree with those of the reference, over the same days."""

    model_config = ConfigDict(from_attributes=True)

    nutrient: str = Field(description="As a column of days, with its unit: energy_kcal.")
    participants: int = Field(description="Participants with a day that is compared.")
    days: int = Field(description="Days that are compared: closed, and wholly known.")
    days_left_out: int = Field(description="Days of the reference that are not.")
    mean: float | None = Field(description="Mean of the participants' means.")
    reference_mean: float | None = Field(description="The same, of the reference.")
    bias: FigureOut | None = Field(description="Mean difference: the study less the reference.")
    lower: FigureOut | None = Field(description="Lower limit of agreement.")
    upper: FigureOut | None = Field(description="Upper limit of agreement.")
    correlation: FigureOut | None = Field(description="Pearson's r; its interval by Fisher's z.")


class ReferenceAgreement(BaseModel):
    """Agreement of each nutrient that the reference has."""

    items: list[NutrientAgreementOut] = Field(description="In the order of the columns of days.")
