"""Parameters that several routes take, each described once."""

import uuid
from typing import Annotated

from fastapi import Path, Query

from app.http.text_schemas import LocalDay
from app.photos.slots import ImageSlot

StudyCode = Annotated[str, Path(max_length=64, description="The study's code.")]
ParticipantCode = Annotated[
    str, Path(max_length=64, description="The participant's pseudonymous code in the study.")
]
StaffName = Annotated[
    str, Path(max_length=200, description="The staff member's name, with which they sign in.")
]
ReleaseName = Annotated[str, Path(max_length=64, description="The release's name in the study.")]
ExportId = Annotated[uuid.UUID, Path(description="The export's id, from the answer that began it.")]
RemeasurementId = Annotated[uuid.UUID, Path(description="The remeasurement's id.")]
VesselId = Annotated[uuid.UUID, Path(description="The vessel's id, not its name.")]
WebhookId = Annotated[uuid.UUID, Path(description="The webhook's id.")]
Slot = Annotated[
    ImageSlot,
    Path(
        description="Which photograph: left, right and view3 to view8 of the meal, after_left and after_right of its "
        "after-meal pair; or a map: left_depth, right_depth, left_confidence, right_confidence; or voice_note."
    ),
]
OfStudy = Annotated[
    str | None,
    Query(
        alias="study",
        max_length=64,
        description="Only this study's; default: all that the caller sees.",
    ),
]
OfParticipant = Annotated[
    str | None,
    Query(alias="participant", max_length=64, description="Only this participant's, by code."),
]
FirstDay = Annotated[LocalDay | None, Query(alias="from", description="First local day, included.")]
LastDay = Annotated[LocalDay | None, Query(alias="to", description="Last local day, included.")]
MealId = Annotated[uuid.UUID, Path(description="The id that the phone made.")]
OfWhichParticipant = Annotated[
    str | None,
    Query(
        alias="participant",
        max_length=64,
        description="Staff: whose meal, if the id alone is not enough.",
    ),
]
