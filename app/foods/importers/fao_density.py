"""Read the workbook of the FAO/INFOODS Density Database 2.0 (2012): densities of foods by name, without nutrients.

Only names and headings indicate whether a density is of the piece or of a heap, and how the food
was prepared. Where they do not decide it, the row is left out: a density of the wrong kind is worse
than none.
"""

import hashlib
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from xml.etree.ElementTree import ParseError

import openpyxl
from openpyxl.utils.exceptions import InvalidFileException

from app.foods.importers.source_files import DAMAGED_ZIP, ImportedTable, ImportFileError, Skipped
from app.nutrition.foods import Density, DensityKind, Food, FoodForm, FoodState, FoodTable
from app.nutrition.portion_density import usual_relative_sd

FORMAT = "fao-density"
SHEET = "Density DB"
RELEASED_ON = date(2012, 1, 1)  # the workbook states only the year
WATER_G_PER_ML = 0.998  # at 20 C, which turns the rows that give only a specific gravity into g/ml
# SR28 and FAO differ by half for crumb and leaves, which hold more or less air
CRUMB_RELATIVE_SD = 0.2
LEAVES_RELATIVE_SD = 0.4
SILO_SOURCE = "ASI"


def _words(alternatives: str) -> re.Pattern[str]:
    return re.compile(rf"\b(?:{alternatives})\b", re.IGNORECASE)


_HEADER = ("food name", "density", "specific gravity", "biblioid")
_NUMBER_OR_RANGE = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*(?:-\s*(\d+(?:\.\d+)?))?\s*$")

_BULK = _words(
    "flour|meal|starch|powders?|powdered|flakes|beans|leaves|grated|chopped|cubed|cubes|rings|dry|dried|chips|"
    "puffed|breadcrumbs|cereal|sugar|table"
)
_POWDER = _words("powders?|powdered")
_CRUMB = re.compile(r"^(bread|cake)\b", re.IGNORECASE)
_LEAVES = _words("leaves")
_LIQUID = re.compile(
    r"^(syrup|sauce|salad dressing|cream\b(?!, (whipped|sour))|sour milk)|\b(brewed|expresso|ready.to.drink)\b|"
    r"\bliquid\b|leaves \+ water",
    re.IGNORECASE,
)
_SPREAD = re.compile(
    r"^(butter|lard|mayonnaise|jam|jelly|nutella|yoghurt|cream, sour)", re.IGNORECASE
)
_ICE = re.compile(r"\bice,|, ice\b", re.IGNORECASE)
_CRYSTAL = re.compile(r"sodium (chloride|bicarbonate)|glutamate", re.IGNORECASE)
_UNCLEAR = re.compile(
    r"^(biscuits|corn/maize, ear|porridge flour .*boiled|powders$|chili\b|spinach, frozen)",
    re.IGNORECASE,
)
_READY = re.compile(r"^(bread|cake|breakfast|porridge,|rice, puffed)", re.IGNORECASE)
_COOKED = _words("boiled|cooked|fried|poached")
_UNCOOKED = _words("raw|dry|dried|fresh|flour")

# Lower-case prefixes of headings. Fruits, meat and eggs are in no list: the sheet does not say
# whether whole or cut.
_LIQUID_SECTIONS = ("beverages", "beer", "spirits", "wine", "milk", "oils", "soups")
_BULK_SECTIONS = (
    "cereal", "tubers", "nuts", "vegetables", "legumes", "herbes", "fish", "snacks", "mixed dishes", "dairy",
)  # fmt: skip
_DRY_SECTION = "cereal"
# without an indication they may be either
_COOKED_OR_RAW_SECTIONS = ("tubers", "vegetables", "legumes", "fish")


@dataclass(frozen=True, slots=True)
class FaoRow:
    """One row.

    row: its number in the sheet, from 1. half_range: of a published range, or 0. biblio_id: its
    source.

    section: the heading above it.
    """

    row: int
    name: str
    g_per_ml: float
    half_range_g_per_ml: float
    biblio_id: str
    section: str


def read_fao_density(path: Path) -> ImportedTable:
    """Return a food per row whose kind of density is clear.

    Raises ImportFileError as read_fao_rows does.
    """
    skipped, foods = Skipped(), []
    for row in read_fao_rows(path).values():
        why, form = _why_left_out(row), _form(row)
        if why is not None or form is None:
            why = why or "rows that do not say whether a piece or a heap was weighed"
            skipped.add(why, f"{row.row} {row.name}")
            continue
        kind: DensityKind = "bulk" if form == "heap" else "solid"
        state = _state(row, form)
        foods.append(
            Food(
                key=f"fao:{row.row}",
                name=row.name,
                food_group=row.section,
                form=form,
                densities=(
                    fao_density(
                        row, form, kind, state or "not told", relative_sd=_relative_sd(row, form)
                    ),
                ),
                source_ids={"fao_density_row": str(row.row)},
                state=state,
                is_mixed_dish=row.section.lower().startswith("mixed dishes"),
            )
        )
    checksum = hashlib.sha256(path.read_bytes()).hexdigest()
    table = FoodTable("fao-infoods-density", "2.0", RELEASED_ON, checksum, tuple(foods))
    return ImportedTable(FORMAT, table, (), skipped)


def fao_density(
    row: FaoRow, form: FoodForm, kind: DensityKind, state: str, *, relative_sd: float | None = None
) -> Density:
    """Return a row as a density.

    relative_sd: replaces the usual spread, which is never less than a range's half.
    """
    share = usual_relative_sd(form, kind) if relative_sd is None else relative_sd
    sd = max(share * row.g_per_ml, row.half_range_g_per_ml)
    text = f'FAO/INFOODS 2012, Density Database 2.0, row {row.row} "{row.name}" ({row.biblio_id})'
    return Density(round(row.g_per_ml, 3), round(sd, 3), state, kind, "fao", text[:300])


def read_fao_rows(path: Path) -> Mapping[int, FaoRow]:
    """Return row number -> row, for the rows with a density or a specific gravity; a range gives its middle.

    Raises ImportFileError if the file is missing or not such a workbook, or a figure in it is
    invalid.
    """
    try:
        cells = [*_cells(path)]
    except FileNotFoundError:
        raise ImportFileError(str(path), None, "there is no such file or folder") from None
    except (*DAMAGED_ZIP, InvalidFileException, ParseError, TypeError, OSError) as error:
        why = f"it is no Excel workbook (.xlsx), or only a part of one: {error}"
        raise ImportFileError(path.name, None, why) from None
    header = [str(cell or "").strip().lower() for cell in cells[0]] if cells else []
    if len(header) < len(_HEADER) or not all(map(str.startswith, header, _HEADER)):
        raise ImportFileError(
            path.name, 1, f"the columns are {', '.join(header)}; expected: {', '.join(_HEADER)}"
        )
    rows: dict[int, FaoRow] = {}
    section = ""
    for number, (name, density, gravity, biblio_id) in enumerate(cells[1:], start=2):
        if name is None:
            continue
        text = " ".join(str(name).split())
        if density is None and gravity is None:
            section = text
            continue
        g_per_ml, half = _middle_and_half(path, number, density, 1.0) or (0.0, 0.0)
        if not g_per_ml:
            g_per_ml, half = _middle_and_half(path, number, gravity, WATER_G_PER_ML) or (0.0, 0.0)
        if not g_per_ml:
            raise ImportFileError(path.name, number, f"the density of {text} is 0")
        rows[number] = FaoRow(number, text, g_per_ml, half, str(biblio_id or "").strip(), section)
    return rows


def _cells(path: Path) -> Iterator[tuple[object, ...]]:
    # From memory, since openpyxl would check the file's extension.
    workbook = openpyxl.load_workbook(io.BytesIO(path.read_bytes()), read_only=True, data_only=True)
    try:
        if SHEET not in workbook.sheetnames:
            why = f"it has no sheet {SHEET!r}; give the FAO/INFOODS Density Database, version 2.0"
            raise ImportFileError(path.name, None, why)
        yield from workbook[SHEET].iter_rows(values_only=True, min_col=1, max_col=4)
    finally:
        workbook.close()


def _middle_and_half(
    path: Path, number: int, cell: object, factor: float
) -> tuple[float, float] | None:
    if cell is None:
        return None
    match = _NUMBER_OR_RANGE.match(str(cell))
    if match is None:
        raise ImportFileError(
            path.name, number, f"{cell!r} is neither a density nor a range of densities"
        )
    low, high = float(match[1]), float(match[2] or match[1])
    return (low + high) / 2.0 * factor, (high - low) / 2.0 * factor


def _why_left_out(row: FaoRow) -> str | None:
    if row.biblio_id == SILO_SOURCE:
        return "rows of ASI, which weighs goods in silos"
    if _CRYSTAL.search(row.name):
        return "rows of a crystal, not of the food that is poured"
    if _ICE.search(row.name):
        return "rows of ice"
    return None


def _form(row: FaoRow) -> FoodForm | None:
    """Return the form of the weighed food; a slab represents any food without air.

    None if it is unclear.
    """
    if _UNCLEAR.match(row.name):
        return None
    if _CRUMB.match(row.name) or _SPREAD.match(row.name):
        return "slab"
    if _LIQUID.search(row.name):
        return "liquid"
    section = row.section.lower()
    if section.startswith(_LIQUID_SECTIONS):
        return "heap" if _POWDER.search(row.name) else "liquid"
    return "heap" if _BULK.search(row.name) or section.startswith(_BULK_SECTIONS) else None


def _state(row: FaoRow, form: FoodForm) -> FoodState | None:
    """Return the state of the weighed food: boiled dry beans are cooked, a dry sherry is not raw."""
    section = row.section.lower()
    if form == "liquid" or section.startswith("mixed dishes") or _READY.match(row.name):
        return "as_eaten"
    if _COOKED.search(row.name):
        return "cooked"
    if _UNCOOKED.search(row.name) or section.startswith(_DRY_SECTION):
        return "raw"
    return None if section.startswith(_COOKED_OR_RAW_SECTIONS) else "as_eaten"


def _relative_sd(row: FaoRow, form: FoodForm) -> float | None:
    if _CRUMB.match(row.name):
        return CRUMB_RELATIVE_SD
    return LEAVES_RELATIVE_SD if form == "heap" and _LEAVES.search(row.name) else None
