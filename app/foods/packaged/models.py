"""The table of packaged foods: what Open Food Facts has of their labels."""

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base
from app.db.columns import BigInt, LongStr, Str300


class PackagedFood(Base):
    """A packaged food of a dump, by its barcode; one that is eaten becomes a food of the same release.

    code: the GTIN as a number, so that leading zeros do not count.
    pack_g, serving_g: of the whole pack and of a serving; ml if is_liquid. NULL: not known.
    per_100_g: JSON, component number -> content of 100 g, or of 100 ml if is_liquid. null: not on
    the label, which is not zero.
    """

    __tablename__ = "packaged_food"

    release_id: Mapped[int] = mapped_column(sa.ForeignKey("food_release.id"), primary_key=True)
    code: Mapped[BigInt] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[Str300]
    is_liquid: Mapped[bool]
    pack_g: Mapped[float | None]
    serving_g: Mapped[float | None]
    per_100_g: Mapped[LongStr]

    __table_args__ = ({"sqlite_with_rowid": False},)
