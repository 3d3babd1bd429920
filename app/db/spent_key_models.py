"""Keys of blobs that are never used again."""

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base


class SpentKey(Base):
    """A blob that no row names is deleted as an orphan, or will be: from now on no row may name it.

    Committed before the deletion, and never removed: whoever deletes may have been stopped for days before they do.
    digest: SHA-256 of the key, so that nothing is told of an erased meal.
    """

    __tablename__ = "spent_key"

    digest: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    spent_at: Mapped[datetime]
