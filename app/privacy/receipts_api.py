"""/v1/receipts: receipts of erasures, which contain no personal data; the id is the only credential needed."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path

from app.http.problems import problem_responses
from app.people.access.deps import State
from app.privacy.erase import find_receipt
from app.privacy.schemas import ReceiptOut

router = APIRouter(prefix="/v1/receipts", tags=["privacy"])


@router.get("/{receipt}", responses=problem_responses(404, 422))
def get_receipt(
    receipt: Annotated[
        uuid.UUID, Path(description="The receipt's id, from the response to the erasure.")
    ],
    state: State,
) -> ReceiptOut:
    """Read a receipt again. It needs no token, since a participant who has left has none."""
    return ReceiptOut.model_validate(find_receipt(state.database, receipt), from_attributes=True)
