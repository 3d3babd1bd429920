"""Look up a packaged food by its barcode, and make it a food when it is eaten."""

import json
import re
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError, NotFoundError
from app.db.session import Database
from app.foods import queries as foods
from app.foods.import_foods import write_foods
from app.foods.models import Food, FoodRelease
from app.foods.packaged.models import PackagedFood
from app.foods.queries import OPEN_FOOD_FACTS
from app.nutrition.foods import Density
from app.nutrition.foods import Food as FoodValue
from app.nutrition.portions import Portion
from app.nutrition.usual_form import usual_form

GROUP = "Packaged foods"
BARCODE = re.compile(r"[0-9]{8}|[0-9]{12,14}")
KEY = re.compile(r"off:([0-9]{13}|[1-9][0-9]{13})")
# a label per 100 ml says nothing of grams: millilitres are right, grams within some 5 %
AS_MILLILITRES = Density(1.0, 0.05, "as_eaten", "solid", "related", "label per 100 ml: 1 ml as 1 g")


@dataclass(frozen=True, slots=True)
class PackagedView:
    """A packaged food as the food that it becomes, and the dump that it is of."""

    row: PackagedFood
    food: FoodValue
    release: FoodRelease


def gtin(digits: str) -> int:
    """Return a barcode's number: leading zeros do not count. Raises InvalidInputError."""
    weighted = (int(digit) * (1 + 2 * (place % 2)) for place, digit in enumerate(reversed(digits)))
    if BARCODE.fullmatch(digits) is None or sum(weighted) % 10:
        raise InvalidInputError(
            "This is no barcode of a food: its 8, 12, 13 or 14 digits end in a check digit, which differs.",
            code="barcode_invalid",
        )
    return int(digits)


def read_packaged(database: Database, digits: str) -> PackagedView:
    """Return the packaged food with this barcode.

    Raises InvalidInputError (`barcode_invalid`), NotFoundError (`barcode_unknown`).
    """
    code = gtin(digits)
    with database.read() as session:
        view = _view(session, code)
    if view is None:
        raise NotFoundError(
            "No packaged food with this barcode is here: enter it as another food.",
            code="barcode_unknown",
            barcode=digits,
        )
    return view


def adopt(session: Session, key: str) -> Food | None:
    """Make the packaged food with this key a food of its release; None if there is none."""
    match = KEY.fullmatch(key)
    view = _view(session, int(match[1])) if match is not None else None
    return _write(session, view.release, [view.row])[0] if view is not None else None


def adopt_again(session: Session, release: FoodRelease) -> None:
    """Take those that were eaten before from a new release as well, so that its figures are at hand."""
    eaten = (
        sa.select(Food.key)
        .join(FoodRelease, FoodRelease.id == Food.release_id)
        .where(FoodRelease.source == OPEN_FOOD_FACTS)
        .group_by(Food.key)
        .having(sa.func.max(Food.release_id) < release.id)
    )
    codes = [int(key.partition(":")[2]) for key in session.scalars(eaten)]
    rows = sa.select(PackagedFood).where(
        PackagedFood.release_id == release.id, PackagedFood.code.in_(codes)
    )
    _write(session, release, list(session.scalars(rows)))


def _view(session: Session, code: int) -> PackagedView | None:
    releases = foods.releases_in_force(session)
    release = next((each for each in releases if each.source == OPEN_FOOD_FACTS), None)
    row = session.get(PackagedFood, (release.id, code)) if release is not None else None
    return PackagedView(row, _food(row), release) if row and release else None


def _write(session: Session, release: FoodRelease, rows: list[PackagedFood]) -> list[Food]:
    components = foods.components_by_number(session)
    ids = {number: component.id for number, component in components.items()}
    return write_foods(session, release, [_food(row) for row in rows], ids)


def _food(row: PackagedFood) -> FoodValue:
    digits = f"{row.code:013d}"
    sizes = (("pack", row.pack_g), ("serving", row.serving_g))
    portions = [(measure, size_g) for measure, size_g in sizes if size_g is not None]
    contents: dict[str, float | None] = json.loads(row.per_100_g)
    return FoodValue(
        key=f"{OPEN_FOOD_FACTS}:{digits}",
        name=row.name,
        food_group=GROUP,
        form="liquid" if row.is_liquid else usual_form(row.name, GROUP),
        densities=(AS_MILLILITRES,) if row.is_liquid else (),
        per_100_g={number: value for number, value in contents.items() if value is not None},
        source_ids={"gtin": digits},
        portions=tuple(
            Portion(str(number), 1.0, measure, size_g)
            for number, (measure, size_g) in enumerate(portions, start=1)
        ),
    )
