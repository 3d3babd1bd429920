"""Participants' rights over their data: export it, delete a meal, leave the study; receipts.

Receipts of erasures contain no personal data; the id is the only credential needed.
"""

import uuid
from collections.abc import Iterator
from datetime import datetime
from typing import IO, Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response, StreamingResponse
from pydantic import BaseModel, Field

from app.core.errors import GoneError, NotFoundError
from app.exports.export_places import ExportPlaces
from app.http.parameters import ParticipantCode, StudyCode
from app.http.problems import problem_responses, render_problem
from app.http.ranges import ClosingStream
from app.http.state import ApiState
from app.http.upload import require_room
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentCaller, CurrentDevice, CurrentStaff, State
from app.people.access.secret_box import SecretBox
from app.people.privacy_models import ErasedKind, ErasurePolicy, ErasureReceipt
from app.people.tombstones import meal_id_of, require_not_deleted
from app.privacy.erase import Eraser, find_receipt
from app.privacy.export_me import export_me
from app.privacy.withdraw import withdraw_participant, withdraw_self

router = APIRouter(prefix="/v1", tags=["privacy"])

PIECE_BYTES = 256 * 1024
EXPORT_RESPONSES = {
    200: {"content": {"application/zip": {}}, "description": "data.json, photographs, README.txt."},
    **problem_responses(401, 403, 410, 503),
}


class ReceiptOut(BaseModel):
    """The numbers of rows that an erasure removed. Keep its id: anyone who has it can read the receipt again."""

    id: uuid.UUID = Field(description="The receipt's id.")
    what: ErasedKind = Field(description="participant, meal or photographs")
    policy: ErasurePolicy = Field(
        description="keep, anonymise, erase; or retention: the study's retention time of photographs has passed."
    )
    counts: dict[str, int] = Field(description="Number of rows removed or changed, by kind.")
    erased_at: datetime = Field(description="When it was erased.")


@router.delete("/meals/{meal_id}", responses=problem_responses(401, 403, 404, 409, 410, 422))
def delete_meal(
    meal_id: Annotated[uuid.UUID, Path(description="The id that the phone made.")],
    state: State,
    caller: CurrentCaller,
    participant: Annotated[
        str | None,
        Query(max_length=64, description="Staff: whose meal, if the id alone is not enough."),
    ] = None,
) -> ReceiptOut:
    """Erase a meal permanently: photographs, derived pictures, items, records. Its id cannot be used again.

    If this answer is lost, a phone that asks again gets 410 `meal_deleted` with the receipt's id as `receipt`.
    """
    return _receipt_out(state.part(Eraser).erase_meal(caller, meal_id, participant))


@router.post("/me/withdrawal", responses=problem_responses(401, 403, 410))
def post_my_withdrawal(state: State, caller: CurrentDevice) -> ReceiptOut:
    """Leave the study: from now on every phone of this participant gets 410.

    The study's policy decides what happens to the data. Show the receipt and keep its id. If this answer is lost, every
    further call's 410 has the id as `receipt`.
    """
    return _receipt_out(withdraw_self(state.part(Eraser), caller))


@router.post(
    "/studies/{study}/participants/{participant}/withdrawal",
    responses=problem_responses(401, 403, 404, 409, 422),
)
def post_participant_withdrawal(
    study: StudyCode,
    participant: ParticipantCode,
    state: State,
    caller: CurrentStaff,
) -> ReceiptOut:
    """Withdraw a participant who has told the study's staff that they leave."""
    return _receipt_out(withdraw_participant(state.part(Eraser), caller, study, participant))


@router.get("/me/export", response_class=StreamingResponse, responses=EXPORT_RESPONSES)
def get_my_export(state: State, caller: CurrentDevice) -> StreamingResponse:
    """All data on the participant of the calling phone, as one ZIP file."""
    require_room(state)
    leave = state.part(ExportPlaces).take(caller.participant_id)
    try:
        file, size = export_me(state.database, state.blobs, caller)
    except BaseException:
        leave()
        raise

    def close() -> None:
        file.close()
        leave()

    return ClosingStream(
        _pieces(file),
        close,
        media_type="application/zip",
        headers={
            "Content-Length": str(size),
            "Content-Disposition": 'attachment; filename="my-data.zip"',
        },
    )


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    while piece := file.read(PIECE_BYTES):
        yield piece


def on_not_found(request: Request, error: NotFoundError) -> Response:
    """Render a NotFoundError; as 410 for a phone whose participant deleted the meal concerned."""
    caller = getattr(request.state, "caller", None)
    client_id = request.path_params.get("meal_id")
    if isinstance(caller, DeviceCaller) and client_id is not None:
        state: ApiState = request.app.state.api
        meal_id = meal_id_of(caller.participant_id, uuid.UUID(client_id))
        try:
            with state.database.read() as session:
                require_not_deleted(session, state.part(SecretBox), meal_id)
        except GoneError as deleted:
            return render_problem(deleted)
    return render_problem(error)


def _receipt_out(receipt: ErasureReceipt) -> ReceiptOut:
    return ReceiptOut.model_validate(receipt, from_attributes=True)


@router.get("/receipts/{receipt}", responses=problem_responses(404, 422))
def get_receipt(
    receipt: Annotated[
        uuid.UUID, Path(description="The receipt's id, from the response to the erasure.")
    ],
    state: State,
) -> ReceiptOut:
    """Read a receipt again. It needs no token, since a participant who has left has none."""
    return ReceiptOut.model_validate(find_receipt(state.database, receipt), from_attributes=True)
