"""Read our own template for national and local tables: a CSV file, one row per food; densities and portions beside it.

The columns are described in docs/foods.md; docs/food-template.csv is an example. An empty cell
means "not known", never 0. Figures are per 100 g edible portion; each component's column names its
unit, which is converted within its quantity.
"""

import hashlib
import re
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from app.core.errors import InvalidInputError
from app.core.units import UnitMismatchError, convert
from app.foods.importers.source_files import (
    MAX_GROUP,
    MAX_KEY,
    MAX_MEASURE,
    MAX_NAME,
    ImportedTable,
    ImportFileError,
    Place,
    Skipped,
    SourceComponent,
    SourceFiles,
    sorted_components,
    unit_of,
)
from app.nutrition.components import COMPONENTS
from app.nutrition.foods import (
    DENSITY_KINDS,
    FOOD_FORMS,
    FOOD_STATES,
    Density,
    Food,
    FoodForm,
    FoodTable,
    RefusePart,
)
from app.nutrition.group_density import with_group_medians
from app.nutrition.plausible import MAX_G_PER_ML, MIN_G_PER_ML, most_in_100_g
from app.nutrition.portion_density import portion_densities, usual_relative_sd
from app.nutrition.portions import Portion
from app.nutrition.usual_form import cup_kind, usual_form

FORMAT = "csv"
FOODS, DENSITIES, PORTIONS = "foods.csv", "densities.csv", "portions.csv"
RESERVED_NAMES = frozenset({"sr28", "fdc", "fao-infoods-density", "tada-starter", "local"})

REQUIRED = ("key", "name", "food_group")
DENSITY_COLUMNS = ("g_per_ml", "sd_g_per_ml", "density_kind", "density_state", "density_source")
ID_COLUMNS = ("foodex2", "fndds", "fdc_id", "sr28_ndb")
COLUMNS = (
    *REQUIRED,
    "aliases",
    "form",
    "state",
    "is_mixed_dish",
    "refuse",
    *DENSITY_COLUMNS,
    *ID_COLUMNS,
)

TRACES = frozenset({"tr", "tr.", "trace", "traces"})
MIN_FOODS_FOR_ENERGY = 10
MIN_ATWATER_KCAL = 20.0  # below, rounding and fruit acids are a large part
_CARBOHYDRATES = ("CHOAVL", "CHOAVLDF", "CHOAVLM", "205.2", "205")  # available carbohydrate first
_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{1,49}")
_KEY = re.compile(r"[A-Za-z0-9._-]+")
_COMPONENT = re.compile(r"(?P<name>\S+)\s*\((?P<unit>[^()]+)\)")
_REFUSE = re.compile(r"(?P<part>\([^()]+\)|[^()\d]+?)\s+(?P<percent>\d+(?:\.\d+)?)\s*%?")
_YES_OR_NO = {
    "": False,
    "no": False,
    "0": False,
    "false": False,
    "yes": True,
    "1": True,
    "true": True,
}

Choice = TypeVar("Choice", bound=str)


@dataclass(frozen=True, slots=True)
class _Row:
    """A line of a file with its cells by column."""

    place: Place
    cells: Mapping[str, str]

    def cell(self, column: str) -> str:
        return self.cells.get(column, "")

    def choice(self, column: str, choices: tuple[Choice, ...]) -> Choice | None:
        text = self.cell(column)
        for choice in choices:
            if choice == text:
                return choice
        if text:
            raise self.place.error(f"{column} is {text!r}; give one of {', '.join(choices)}")
        return None

    def number(self, column: str) -> float:
        return self.place.number(column, self.cell(column))

    def text(self, column: str, limit: int, default: str = "") -> str:
        return self.place.text(column, self.cell(column) or default, limit)


def read_csv_table(path: Path, *, name: str, version: str, released_on: date) -> ImportedTable:
    """Read and validate a table: a CSV file, or foods.csv, densities.csv and portions.csv of a folder or zip.

    name: of the release, and the first part of each food's key. Raises ImportFileError, with file,
    line and column, at the first error; InvalidInputError if name or version is invalid.
    """
    if not _NAME.fullmatch(name) or name in RESERVED_NAMES:
        why = "lower-case letters, digits, '.', '_' and '-', 2 to 50 of them, and no name of a published table"
        raise InvalidInputError(f"The table's name cannot be {name!r}: {why}.")
    if not 0 < len(version.strip()) <= 32:
        raise InvalidInputError("The table's version has 1 to 32 characters.")
    files, skipped = SourceFiles(path), Skipped()
    foods_file = files.plain_file or FOODS
    files.require([foods_file])
    rows = [_Row(place, cells) for place, cells in files.csv_rows(foods_file)]
    components = _components(files, foods_file)
    keys: dict[str, None] = {}
    for row in rows:
        key = row.text("key", MAX_KEY - len(name) - 1)
        if not _KEY.fullmatch(key):
            raise row.place.error(
                f"key {key!r} has more in it than letters, digits, '.', '_' and '-'"
            )
        keys[row.place.new_key("food", key, keys)] = None
    if not rows:
        raise ImportFileError(foods_file, None, "it holds no food")
    portions, densities = _portions(files, keys), _densities(files, keys)
    foods = [
        _food(
            row,
            name,
            components,
            portions.get(row.cell("key"), []),
            densities.get(row.cell("key"), []),
            skipped,
        )
        for row in rows
    ]
    _require_likely_energy(foods_file, foods)
    checksum = _checksum(files, foods_file, f"{name} {version} {released_on}")
    table = FoodTable(name, version.strip(), released_on, checksum, with_group_medians(foods, name))
    by_number = {source.component.number: source.component for source in components.values()}
    return ImportedTable(FORMAT, table, sorted_components(by_number), skipped)


def _components(files: SourceFiles, file: str) -> dict[str, SourceComponent]:
    """Return column -> component, for each column that is not one of COLUMNS."""
    _, header = next(files.lines(file, "utf-8-sig"), (1, ""))
    if ";" in header and "," not in header:
        raise ImportFileError(
            file, 1, "the columns are separated by semicolons; save the table with commas"
        )
    components: dict[str, SourceComponent] = {}
    for column in files.csv_header(file, REQUIRED):
        if column not in COLUMNS:
            source = _component(file, column)
            if any(source.component == other.component for other in components.values()):
                raise ImportFileError(
                    file, 1, f"column {column!r}: {source.component.name} has a column already"
                )
            components[column] = source
    return components


def _component(file: str, column: str) -> SourceComponent:
    match = _COMPONENT.fullmatch(column)
    if match is None:
        why = f"column {column!r} is neither one of {', '.join(COLUMNS)} nor a component such as 'CA (mg)'"
        raise ImportFileError(file, 1, why)
    name, unit = match["name"], unit_of(match["unit"])
    if unit is None:
        raise ImportFileError(file, 1, f"column {column!r}: unknown unit {match['unit']!r}")
    candidates = [
        component for component in COMPONENTS if name in (component.number, component.tagname)
    ]
    if not candidates:
        tagnames = [component.tagname for component in COMPONENTS if component.tagname]
        near = [tagname for tagname in tagnames if tagname.startswith(name.upper())]
        hint = f"; did you mean {' or '.join(near[:3])}?" if near else ""
        raise ImportFileError(file, 1, f"column {column!r}: unknown component {name!r}{hint}")
    for component in candidates:  # VITD is 328 in ug and 324 in IU
        try:
            return SourceComponent(component, convert(1.0, unit, component.unit))
        except UnitMismatchError:
            continue
    units = " or ".join(component.unit for component in candidates)
    raise ImportFileError(
        file, 1, f"column {column!r}: {unit} does not fit {name}, which is given in {units}"
    )


def _food(
    row: _Row,
    name: str,
    components: Mapping[str, SourceComponent],
    portions: list[Portion],
    densities: list[_Row],
    skipped: Skipped,
) -> Food:
    key, title = row.cell("key"), row.text("name", MAX_NAME)
    group = row.text("food_group", MAX_GROUP)
    form = row.choice("form", FOOD_FORMS) or usual_form(title, group)
    state = row.choice("state", FOOD_STATES)
    mixed = row.cell("is_mixed_dish").lower()
    if mixed not in _YES_OR_NO:
        raise row.place.error(f"is_mixed_dish is {mixed!r}; give yes or no")
    measured = [
        _density(density_row, form, state or "not told")
        for density_row in (row, *densities)
        if density_row.cell("g_per_ml")
    ]
    if not row.cell("g_per_ml") and any(row.cell(column) for column in DENSITY_COLUMNS):
        raise row.place.error("there is a density's kind, spread, state or source, but no g_per_ml")
    of_portions = portion_densities(
        portions,
        form,
        state or "not told",
        f"{name}, {key}",
        cup_kind=cup_kind(title, group, form),
    )
    return Food(
        key=f"{name}:{key}",
        name=title,
        aliases=tuple(
            dict.fromkeys(
                alias.strip() for alias in row.cell("aliases").split(";") if alias.strip()
            )
        ),
        food_group=group,
        form=form,
        refuse=tuple(_refuse(row)),
        densities=(*measured, *of_portions),
        per_100_g=MappingProxyType(dict(_contents(row, components, skipped))),
        source_ids={column: row.cell(column) for column in ID_COLUMNS if row.cell(column)},
        state=state,
        is_mixed_dish=_YES_OR_NO[mixed],
        portions=tuple(portions),
    )


def _contents(
    row: _Row, components: Mapping[str, SourceComponent], skipped: Skipped
) -> Iterator[tuple[str, float]]:
    for column, source in components.items():
        text = row.cell(column)
        if not text:
            continue
        if text.lower() in TRACES:
            skipped.add("traces, taken as 0", f"{row.cell('key')} {column}")
            yield source.component.number, 0.0
            continue
        value = row.place.number(column, text) * source.factor
        if value > most_in_100_g(source.component):
            raise row.place.error(
                f"{column} is {text}: more than 100 g of any food can hold; is the unit right?"
            )
        yield source.component.number, value


def _density(row: _Row, form: FoodForm, usual_state: str) -> Density:
    kind = row.choice("density_kind", DENSITY_KINDS)
    if kind is None:
        raise row.place.error(f"a density needs its density_kind: {' or '.join(DENSITY_KINDS)}")
    g_per_ml = row.number("g_per_ml")
    if not MIN_G_PER_ML <= g_per_ml <= MAX_G_PER_ML:
        raise row.place.error(f"g_per_ml is {g_per_ml:g}, which no food has")
    spread = (
        row.number("sd_g_per_ml")
        if row.cell("sd_g_per_ml")
        else usual_relative_sd(form, kind) * g_per_ml
    )
    state = row.text("density_state", 32, usual_state)
    source = row.text("density_source", 300)
    return Density(g_per_ml, spread, state, kind, "measured", source)


def _refuse(row: _Row) -> Iterator[RefusePart]:
    total = 0.0
    for piece in filter(None, (piece.strip() for piece in row.cell("refuse").split(";"))):
        match = _REFUSE.fullmatch(piece)
        if match is None:
            raise row.place.error(
                f"refuse {piece!r} is no part with its percent, such as 'peel 30; core 10'"
            )
        total += float(match["percent"])
        part = match["part"]
        yield RefusePart(
            part.strip("()").strip(), float(match["percent"]), is_served=not part.startswith("(")
        )
    if total >= 100.0:
        raise row.place.error(f"a refuse of {total:g} % leaves nothing to eat")


def _portions(files: SourceFiles, keys: Mapping[str, None]) -> dict[str, list[Portion]]:
    portions: dict[str, list[Portion]] = {}
    for row in _beside(files, PORTIONS, ("key", "amount", "measure", "mass_g"), (), keys):
        of_food = portions.setdefault(row.cell("key"), [])
        amount, mass_g = row.number("amount"), row.number("mass_g")
        if amount == 0.0 or mass_g == 0.0:
            raise row.place.error("amount and mass_g are more than 0")
        measure = row.text("measure", MAX_MEASURE)
        of_food.append(Portion(str(len(of_food) + 1), amount, measure, mass_g))
    return portions


def _densities(files: SourceFiles, keys: Mapping[str, None]) -> dict[str, list[_Row]]:
    densities: dict[str, list[_Row]] = {}
    required = ("key", "g_per_ml", "density_kind", "density_source")
    for row in _beside(files, DENSITIES, required, ("sd_g_per_ml", "density_state"), keys):
        if not row.cell("g_per_ml"):
            raise row.place.error("g_per_ml is empty")
        densities.setdefault(row.cell("key"), []).append(row)
    return densities


def _beside(
    files: SourceFiles,
    file: str,
    required: tuple[str, ...],
    optional: tuple[str, ...],
    keys: Mapping[str, None],
) -> Iterator[_Row]:
    """Yield the rows of an optional file beside foods.csv; each must be of a food in foods.csv."""
    if not files.has(file):
        return
    unknown = [
        column
        for column in files.csv_header(file, required)
        if column not in (*required, *optional)
    ]
    if unknown:
        raise ImportFileError(
            file,
            1,
            f"unknown column {', '.join(unknown)}; there are {', '.join(required + optional)}",
        )
    for place, cells in files.csv_rows(file, required):
        row = _Row(place, cells)
        if row.cell("key") not in keys:
            raise row.place.error(f"food {row.cell('key')!r} is none of {FOODS}")
        yield row


def _require_likely_energy(file: str, foods: Sequence[Food]) -> None:
    """Raise ImportFileError if energies differ widely from those of the macronutrients: kcal in a column of kJ.

    Uses the median over at least ten foods with all of them: single foods may deviate (polyols,
    fibre, vinegar), and general Atwater factors are within some 20 % for most.
    """
    ratios = []
    for food in foods:
        contents = food.per_100_g
        carbohydrate = next(
            (contents[number] for number in _CARBOHYDRATES if number in contents), None
        )
        if (
            "208" in contents
            and "203" in contents
            and "204" in contents
            and carbohydrate is not None
        ):
            atwater = (
                4.0 * contents["203"]
                + 9.0 * contents["204"]
                + 4.0 * carbohydrate
                + 7.0 * contents.get("221", 0.0)
            )
            if atwater > MIN_ATWATER_KCAL:
                ratios.append(contents["208"] / atwater)
    if len(ratios) >= MIN_FOODS_FOR_ENERGY and not 0.5 < statistics.median(ratios) < 2.0:
        why = f"the energies are {statistics.median(ratios):.2g} times what protein, fat and carbohydrate hold"
        raise ImportFileError(file, 1, f"{why}: kcal under a header of kJ, or the reverse?")


def _checksum(files: SourceFiles, foods_file: str, release: str) -> str:
    """Return the checksum of the files' content and the release's name, version and date; file names do not matter."""
    digest = hashlib.sha256(release.encode())
    for role, file in ((FOODS, foods_file), (DENSITIES, DENSITIES), (PORTIONS, PORTIONS)):
        if files.has(file):
            with files.open(file) as content:
                digest.update(f"\n{role} {hashlib.sha256(content.read()).hexdigest()}".encode())
    return digest.hexdigest()
