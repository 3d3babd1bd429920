"""A study's vessel library over the wire."""

import uuid
from datetime import datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field
from pydantic.config import JsonDict

from app.http.page_of import PageOf
from app.http.text_schemas import Number, Text
from app.vision.vessel_library import (
    CAPACITY_ML,
    HEIGHT_MM,
    MAX_PROFILE_POINTS,
    RIM_DIAMETER_MM,
    VesselKind,
)

VesselName = Annotated[
    Text, Field(min_length=1, max_length=100, description="Unique in the study, without case.")
]
Profile = Annotated[
    list[tuple[Number, Number]],
    Field(
        max_length=MAX_PROFILE_POINTS,
        description="[radius, height over the table] of the inside, mm, from the middle of the floor up to the brim.",
    ),
]


class VesselMeasures(BaseModel):
    """What is measured of a vessel once: rim and height, and capacity, a fill line or the profile of its inside."""

    kind: VesselKind = Field(description="What kind of vessel it is.")
    rim_diameter_mm: Annotated[
        Number,
        Field(ge=RIM_DIAMETER_MM[0], le=RIM_DIAMETER_MM[1], description="Inside, at the brim."),
    ]
    height_mm: Annotated[
        Number, Field(ge=HEIGHT_MM[0], le=HEIGHT_MM[1], description="Of the brim over the table.")
    ]
    capacity_ml: Annotated[Number, Field(ge=CAPACITY_ML[0], le=CAPACITY_ML[1])] | None = Field(
        default=None, description="Filled to the brim."
    )
    fill_line_mm: Annotated[Number, Field(gt=0, le=HEIGHT_MM[1])] | None = Field(
        default=None, description="A mark's height over the table; goes with fill_line_ml."
    )
    fill_line_ml: Annotated[Number, Field(ge=CAPACITY_ML[0], le=CAPACITY_ML[1])] | None = Field(
        default=None, description="What the vessel holds up to the mark."
    )
    inside_profile_mm: Profile = []


EXAMPLE: JsonDict = {
    "kind": "mug",
    "rim_diameter_mm": 82.0,
    "height_mm": 95.0,
    "capacity_ml": 330.0,
}


class VesselIn(VesselMeasures):
    """A new vessel."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"name": "Blue mug", **EXAMPLE}}
    )

    name: VesselName


class VesselChangeIn(VesselMeasures):
    """A vessel measured anew: all its measures. A retired one is in use again."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": EXAMPLE})

    name: VesselName | None = Field(
        default=None, description="May be left out; another name than the vessel's is 409."
    )


class PhoneVesselOut(VesselMeasures):
    """A vessel in use, for a phone to offer: a hint names it."""

    name: str = Field(description="The vessel's name, unique in the study.")
    version: int = Field(description="Grows with every change of the vessel.")


class VesselOut(PhoneVesselOut):
    """A vessel in one of its versions. version: what its ETag names; author: whose version it is."""

    id: uuid.UUID = Field(description="The vessel's id.")
    is_retired: bool = Field(description="Whether it is out of use: phones do not offer it.")
    author: str = Field(description="Name of the staff member who made this version.")
    created_at: datetime = Field(description="When the vessel was made.")
    changed_at: datetime = Field(description="When this version was made.")


class VesselList(PageOf[VesselOut]):
    """A page of a study's vessels by name."""


class PhoneVesselList(BaseModel):
    """All vessels in use by name."""

    items: list[PhoneVesselOut] = Field(description="The vessels in use.")
