"""The values of the food table: foods, their refuse, densities and nutrients; and the starter table in the package.

Values only, validated when they are made; choosing a density is density.py's business. Made by build_starter.py.
"""

import csv
import hashlib
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any, Literal, get_args

from app.nutrition.components import COMPONENT_BY_TAGNAME

FoodForm = Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"]
SliceForm = Literal["circle", "ellipse"]
DensityKind = Literal["solid", "bulk"]
DensityBasis = Literal["study", "measured", "fao", "portion", "related", "group"]

FOOD_FORMS: tuple[FoodForm, ...] = get_args(FoodForm)
DENSITY_KINDS: tuple[DensityKind, ...] = get_args(DensityKind)
DENSITY_BASES: tuple[DensityBasis, ...] = get_args(DensityBasis)


@dataclass(frozen=True, slots=True)
class RefusePart:
    """An inedible part: percent of the whole food's mass. is_served: usually still on it in a photograph."""

    part: str
    percent: float
    is_served: bool = True


@dataclass(frozen=True, slots=True)
class Density:
    """A food's density with its spread: what the next item of this food may differ from it, one standard deviation.

    kind: "solid", of the piece or the liquid itself; "bulk", of a heap with the air between its pieces.
    state: how the food was when weighed (raw, boiled, mashed, sliced ...). basis: how it was come by, best first in
    DENSITY_BASES. source: for a person, with the source's ids.
    """

    g_per_ml: float
    sd_g_per_ml: float
    state: str
    kind: DensityKind
    basis: DensityBasis
    source: str

    def __post_init__(self) -> None:
        if not (0.0 < self.g_per_ml < math.inf and 0.0 <= self.sd_g_per_ml < math.inf):
            raise ValueError(f"no density: {self.g_per_ml} +- {self.sd_g_per_ml} g/ml ({self.source})")
        if self.kind not in DENSITY_KINDS or self.basis not in DENSITY_BASES:
            raise ValueError(f"unknown density kind {self.kind!r} or basis {self.basis!r} ({self.source})")

    @property
    def relative_sd(self) -> float:
        """The spread as a share of the density."""
        return self.sd_g_per_ml / self.g_per_ml


@dataclass(frozen=True, slots=True)
class Food:
    """One food of a release.

    key: a slug that names the same food across releases. form: how it usually lies on the plate. slice_form: what the
    paper's method fits to its slices (section V), None where its slices decide. refuse: parts of the whole food that
    are not eaten. densities: in the order of their worth. per_100_g: tagname -> content of 100 g edible portion in the
    component's unit; what is not known is absent, never 0. source_ids: such as {"sr28_ndb": "09003"}.
    """

    key: str
    name: str
    aliases: tuple[str, ...]
    food_group: str
    form: FoodForm
    slice_form: SliceForm | None
    refuse: tuple[RefusePart, ...]
    densities: tuple[Density, ...]
    per_100_g: Mapping[str, float]
    source_ids: Mapping[str, str]

    def __post_init__(self) -> None:
        if self.form not in FOOD_FORMS:
            raise ValueError(f"{self.key}: unknown form {self.form!r}")
        if any(part.percent < 0.0 for part in self.refuse) or sum(part.percent for part in self.refuse) >= 100.0:
            raise ValueError(f"{self.key}: its refuse leaves nothing to eat")
        for tagname, content in self.per_100_g.items():
            if tagname not in COMPONENT_BY_TAGNAME or not 0.0 <= content < math.inf:
                raise ValueError(f"{self.key}: no content of a known component: {tagname} {content}")


@dataclass(frozen=True, slots=True)
class FoodTable:
    """One release of a food table. checksum: SHA-256 of what it was read from, hex. foods: in the table's order."""

    name: str
    version: str
    released_on: date
    checksum: str
    foods: tuple[Food, ...]

    def food(self, key: str) -> Food:
        """The food with this key. Raises KeyError if there is none."""
        for food in self.foods:
            if food.key == key:
                return food
        raise KeyError(key)


@cache
def load_starter_table() -> FoodTable:
    """The table that ships in the package (docs/food-table.md): foods.json and nutrients.csv of starter/."""
    folder = resources.files("app.nutrition") / "starter"
    return parse_table((folder / "foods.json").read_bytes(), (folder / "nutrients.csv").read_bytes())


def parse_table(foods_json: bytes, nutrients_csv: bytes) -> FoodTable:
    """The two files of a table as build_starter.py writes them -> the table.

    Raises ValueError, KeyError or TypeError where they are not such files.
    """
    document = json.loads(foods_json)
    contents = {
        row.pop("key"): MappingProxyType({tagname: float(text) for tagname, text in row.items() if text})
        for row in csv.DictReader(io.StringIO(nutrients_csv.decode()))
    }
    release = document["release"]
    return FoodTable(
        name=release["name"],
        version=release["version"],
        released_on=date.fromisoformat(release["released_on"]),
        checksum=hashlib.sha256(foods_json + nutrients_csv).hexdigest(),
        foods=tuple(_food(entry, contents[entry["key"]]) for entry in document["foods"]),
    )


def _food(entry: dict[str, Any], per_100_g: Mapping[str, float]) -> Food:
    return Food(
        key=entry["key"],
        name=entry["name"],
        aliases=tuple(entry["aliases"]),
        food_group=entry["food_group"],
        form=entry["form"],
        slice_form=entry["slice_form"],
        refuse=tuple(RefusePart(**part) for part in entry["refuse"]),
        densities=tuple(Density(**density) for density in entry["densities"]),
        per_100_g=per_100_g,
        source_ids=MappingProxyType(entry["source_ids"]),
    )
