"""Values of the food table: foods, refuse, densities and nutrients; and the starter table in the package.

Values are validated on construction; density.py chooses densities. The starter table is built by
tools/starter_table.
"""

import csv
import hashlib
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any, Literal, get_args

from app.nutrition.components import NUMBER_BY_TAGNAME
from app.nutrition.portions import Portion

FoodForm = Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"]
SliceForm = Literal["circle", "ellipse"]
DensityKind = Literal["solid", "bulk"]
DensityBasis = Literal["study", "measured", "fao", "portion", "related", "composition", "group"]
WeighedPart = Literal["as_seen", "edible"]
FoodState = Literal["raw", "cooked", "as_eaten"]

FOOD_FORMS: tuple[FoodForm, ...] = get_args(FoodForm)
FOOD_STATES: tuple[FoodState, ...] = get_args(FoodState)
SLICE_FORMS: tuple[SliceForm, ...] = get_args(SliceForm)
DENSITY_KINDS: tuple[DensityKind, ...] = get_args(DensityKind)
DENSITY_BASES: tuple[DensityBasis, ...] = get_args(DensityBasis)
WEIGHED_PARTS: tuple[WeighedPart, ...] = get_args(WeighedPart)


def food_form(text: str | None) -> FoodForm | None:
    """Return a text as one of FOOD_FORMS, None for None.

    Raises ValueError if it is not one of them.
    """
    for form in FOOD_FORMS:
        if form == text:
            return form
    if text is None:
        return None
    raise ValueError(f"unknown form {text!r}")


@dataclass(frozen=True, slots=True)
class RefusePart:
    """An inedible part: percent of the whole food's mass.

    is_served: usually still on it in a photograph.
    """

    part: str
    percent: float
    is_served: bool = True


@dataclass(frozen=True, slots=True)
class Density:
    """A food's density and spread: the standard deviation of another item of this food from it.

    kind: "solid", of the piece or the liquid itself; "bulk", of a heap with the air between its
    pieces. state: of the food when weighed (raw, boiled, mashed, sliced ...). basis: how the
    density was obtained; DENSITY_BASES has the best first. source: readable, with the source's ids.
    weighs: "edible" if a table gives the edible mass in a volume that includes waste ("1 cup, with
    pits, yields"): refuse is not subtracted again.
    """

    g_per_ml: float
    sd_g_per_ml: float
    state: str
    kind: DensityKind
    basis: DensityBasis
    source: str
    weighs: WeighedPart = "as_seen"

    def __post_init__(self) -> None:
        if not (0.0 < self.g_per_ml < math.inf and 0.0 <= self.sd_g_per_ml < math.inf):
            raise ValueError(
                f"invalid density: {self.g_per_ml} +- {self.sd_g_per_ml} g/ml ({self.source})"
            )
        is_valid = (
            self.kind in DENSITY_KINDS
            and self.basis in DENSITY_BASES
            and self.weighs in WEIGHED_PARTS
        )
        if not is_valid:
            raise ValueError(
                f"unknown kind {self.kind!r}, basis {self.basis!r} or {self.weighs!r} ({self.source})"
            )

    @property
    def relative_sd(self) -> float:
        """Return the spread as a share of the density."""
        return self.sd_g_per_ml / self.g_per_ml


@dataclass(frozen=True, slots=True)
class Food:
    """One food of a release.

    key: identifies the food across releases: a slug, or SOURCE:ID for a food of an imported table.
    form: its usual form on the plate. slice_form: the shape that the paper's method fits to its
    slices (section V); None: chosen by fit. state: raw (dry goods too), cooked, or as_eaten (bread,
    milk, a dish); None if the source does not state it: raw and cooked are never interchangeable.
    refuse: parts of the whole food that are not eaten. densities: the best first. portions: as the
    source gives them, of edible mass. per_100_g: component number -> content of 100 g edible
    portion in the component's unit; an unknown content is absent, never 0. source_ids: such as
    {"sr28_ndb": "09003"}. probes: questions for the participant about what no camera sees
    (fat_added, sweetened, drained, dressing ...). Raises ValueError if a value is invalid.
    """

    key: str
    name: str
    food_group: str
    form: FoodForm
    aliases: tuple[str, ...] = ()
    slice_form: SliceForm | None = None
    state: FoodState | None = None
    is_mixed_dish: bool = False
    refuse: tuple[RefusePart, ...] = ()
    densities: tuple[Density, ...] = ()
    portions: tuple[Portion, ...] = ()
    probes: tuple[str, ...] = ()
    source_ids: Mapping[str, str] = field(default_factory=dict)
    per_100_g: Mapping[str, float] = field(default_factory=dict)

    @property
    def members(self) -> tuple[str, ...]:
        """Keys of the foods that this group of foods stands for; none for a food."""
        return tuple(self.source_ids.get("members", "").split())

    def __post_init__(self) -> None:
        if self.form not in FOOD_FORMS:
            raise ValueError(f"{self.key}: unknown form {self.form!r}")
        if self.slice_form is not None and self.slice_form not in SLICE_FORMS:
            raise ValueError(f"{self.key}: unknown slice form {self.slice_form!r}")
        if self.state is not None and self.state not in FOOD_STATES:
            raise ValueError(f"{self.key}: unknown state {self.state!r}")
        if (
            any(part.percent < 0.0 for part in self.refuse)
            or sum(part.percent for part in self.refuse) >= 100.0
        ):
            raise ValueError(f"{self.key}: its refuse leaves nothing to eat")
        for number, content in self.per_100_g.items():
            if not 0.0 <= content < math.inf:
                raise ValueError(f"{self.key}: component {number} cannot be {content}")


@dataclass(frozen=True, slots=True)
class FoodTable:
    """One release of a food table.

    checksum: SHA-256 of its source files, hex. foods: in the table's order.
    """

    name: str
    version: str
    released_on: date
    checksum: str
    foods: tuple[Food, ...]

    def food(self, key: str) -> Food:
        """Return the food with this key. Raises KeyError if there is none."""
        for food in self.foods:
            if food.key == key:
                return food
        raise KeyError(key)


@cache
def load_starter_table() -> FoodTable:
    """Return the table in the package (docs/food-table.md): foods.json and nutrients.csv of starter/."""
    return parse_table(*_starter_files())


def starter_checksum() -> str:
    """Return the checksum of the table in the package without parsing it."""
    return _checksum(*_starter_files())


def _starter_files() -> tuple[bytes, bytes]:
    folder = resources.files("app.nutrition") / "starter"
    return (folder / "foods.json").read_bytes(), (folder / "nutrients.csv").read_bytes()


def _checksum(foods_json: bytes, nutrients_csv: bytes) -> str:
    return hashlib.sha256(foods_json + nutrients_csv).hexdigest()


def parse_table(foods_json: bytes, nutrients_csv: bytes) -> FoodTable:
    """Return the table of the two files that tools/starter_table/build.py writes.

    Raises ValueError, KeyError or TypeError if they are not such files.
    """
    document = json.loads(foods_json)
    contents = {
        row.pop("key"): MappingProxyType(
            {NUMBER_BY_TAGNAME[tagname]: float(text) for tagname, text in row.items() if text}
        )
        for row in csv.DictReader(io.StringIO(nutrients_csv.decode()))
    }
    release = document["release"]
    return FoodTable(
        name=release["name"],
        version=release["version"],
        released_on=date.fromisoformat(release["released_on"]),
        checksum=_checksum(foods_json, nutrients_csv),
        foods=tuple(_food(entry, contents[entry["key"]]) for entry in document["foods"]),
    )


def _food(entry: dict[str, Any], per_100_g: Mapping[str, float]) -> Food:
    parts = {
        "aliases": tuple(entry["aliases"]),
        "refuse": tuple(RefusePart(*part) for part in entry["refuse"]),
        "densities": tuple(Density(*density) for density in entry["densities"]),
        "portions": tuple(Portion(*portion) for portion in entry["portions"]),
        "probes": tuple(entry["probes"]),
        "source_ids": MappingProxyType(entry["source_ids"]),
    }
    return Food(**entry | parts, per_100_g=per_100_g)
