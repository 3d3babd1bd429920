"""Types of columns for `Mapped[…]`: texts by greatest length, keys, versions, references.

A column's own `mapped_column(…)` adds to these (an index, a default); `| None` makes it nullable.
"""

import uuid
from typing import Annotated

import sqlalchemy as sa
from sqlalchemy.orm import mapped_column

Str8 = Annotated[str, mapped_column(sa.String(8))]
Str16 = Annotated[str, mapped_column(sa.String(16))]
Str32 = Annotated[str, mapped_column(sa.String(32))]
Str64 = Annotated[str, mapped_column(sa.String(64))]
Str100 = Annotated[str, mapped_column(sa.String(100))]
Str200 = Annotated[str, mapped_column(sa.String(200))]
Str300 = Annotated[str, mapped_column(sa.String(300))]
Str500 = Annotated[str, mapped_column(sa.String(500))]
LongStr = Annotated[str, mapped_column(sa.Text)]
Version = Annotated[int, mapped_column(default=1)]
BigInt = Annotated[int, mapped_column(sa.BigInteger)]

IntKey = Annotated[int, mapped_column(primary_key=True)]
UuidKey = Annotated[uuid.UUID, mapped_column(primary_key=True)]

DeviceRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("device.id"))]
FoodRef = Annotated[int, mapped_column(sa.ForeignKey("food.id"))]
ItemRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("item.id"))]
JobRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("job.id"))]
MealEventRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("meal_event.id"))]
MealRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("meal.id"))]
ParticipantRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("participant.id"))]
ReleaseRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("release.id"))]
RunRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("run.id"))]
StaffRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("staff.id"))]
StudyRef = Annotated[uuid.UUID, mapped_column(sa.ForeignKey("study.id"))]
