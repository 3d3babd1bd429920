"""/v1/receipts: what an erasure removed, for whoever holds the receipt's id, token or not: it names nobody."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path

from app.http.problems import problem_responses
from app.people.access.deps import State
from app.people.privacy_schemas import ReceiptOut
from app.privacy.erase import find_receipt

router = APIRouter(prefix="/v1/receipts", tags=["privacy"])


@router.get("/{receipt}", responses=problem_responses(404, 422))
def get_receipt(
    receipt: Annotated[uuid.UUID, Path(description="The id that the erasure answered with: 122 random bits.")],
    state: State,
) -> ReceiptOut:
    """A receipt again. A participant who has left has no token any more, so it needs none."""
    return ReceiptOut.model_validate(find_receipt(state.database, receipt), from_attributes=True)
