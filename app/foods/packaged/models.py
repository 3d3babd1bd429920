"""The table of packaged foods: what Open Food Facts has of their labels."""

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base


class PackagedFood(Base):
    """A packaged food of a dump, by its barcode; one that is eaten becomes a food of the same release.

    code: the GTIN as a number, so that leading zeros do not count.
    pack_g, serving_g: of the whole pack and of a serving; ml if is_liquid. NULL: not known.
    Figures are of 100 g, or of 100 ml if is_liquid. carbohydrate_g includes fibre,
    available_carbohydrate_g does not. NULL: not on the label, which is not zero.
    """

    __tablename__ = "packaged_food"

    release_id: Mapped[int] = mapped_column(sa.ForeignKey("food_release.id"), primary_key=True)
    code: Mapped[int] = mapped_column(sa.BigInteger, primary_key=True, autoincrement=False)
    name: Mapped[str] = mapped_column(sa.String(300))
    brands: Mapped[str | None] = mapped_column(sa.String(200))
    is_liquid: Mapped[bool]
    pack_g: Mapped[float | None]
    serving_g: Mapped[float | None]
    energy_kcal: Mapped[float | None]
    protein_g: Mapped[float | None]
    fat_g: Mapped[float | None]
    saturated_fat_g: Mapped[float | None]
    carbohydrate_g: Mapped[float | None]
    available_carbohydrate_g: Mapped[float | None]
    sugar_g: Mapped[float | None]
    fibre_g: Mapped[float | None]
    sodium_mg: Mapped[float | None]

    __table_args__ = ({"sqlite_with_rowid": False},)


# column -> number of its component
LABEL_COMPONENTS = {
    "energy_kcal": "208",
    "protein_g": "203",
    "fat_g": "204",
    "saturated_fat_g": "606",
    "carbohydrate_g": "205",
    "available_carbohydrate_g": "CHOAVL",
    "sugar_g": "269",
    "fibre_g": "291",
    "sodium_mg": "307",
}
