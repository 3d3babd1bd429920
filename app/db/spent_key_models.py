"""The table of blob keys that must never be used again."""

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base


class SpentKey(Base):
    """The key of a blob that is or will be deleted as an orphan: no row may name it any more.

    Committed before the deletion and never removed, since the deleting process may be suspended for days in between.
    digest: SHA-256 of the key, which reveals nothing about an erased meal.
    """

    __tablename__ = "spent_key"

    digest: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    spent_at: Mapped[datetime]
