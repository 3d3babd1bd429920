"""HTTP schemas of receipts of erasures."""

import uuid
from datetime import datetime

from pydantic import BaseModel, Field

from app.people.privacy_models import ErasedKind, ErasurePolicy


class ReceiptOut(BaseModel):
    """The numbers of rows that an erasure removed. Keep its id: anyone who has it can read the receipt again."""

    id: uuid.UUID = Field(description="The receipt's id.")
    what: ErasedKind = Field(description="participant, meal or photographs")
    policy: ErasurePolicy = Field(
        description="keep, anonymise, erase; or retention: the study's retention time of photographs has passed."
    )
    counts: dict[str, int] = Field(description="Number of rows removed or changed, by kind.")
    erased_at: datetime = Field(description="When it was erased.")
