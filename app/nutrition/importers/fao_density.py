"""FAO/INFOODS Density Database 2.0 (2012), the workbook -> its rows. Reading it needs openpyxl (a development tool)."""

import importlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

SHEET = "Density DB"
WATER_G_PER_ML = 0.998  # at 20 C, which turns the rows that give only a specific gravity into g/ml

_NUMBER_OR_RANGE = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*(?:-\s*(\d+(?:\.\d+)?))?\s*$")


@dataclass(frozen=True, slots=True)
class FaoRow:
    """One row. row: its number in the sheet, from 1. half_range: of a published range, or 0. biblio_id: whose it is."""

    row: int
    name: str
    g_per_ml: float
    half_range_g_per_ml: float
    biblio_id: str


def read_fao_rows(path: Path) -> Mapping[int, FaoRow]:
    """Row number -> row, for the rows with a density or a specific gravity; a range gives its middle.

    Raises FileNotFoundError if there is no such file, ModuleNotFoundError without openpyxl, ValueError if the workbook
    is another one.
    """
    workbook = importlib.import_module("openpyxl").load_workbook(path, read_only=True)
    try:
        if SHEET not in workbook.sheetnames:
            raise ValueError(f"{path} has no sheet {SHEET!r}; give the FAO/INFOODS Density Database, version 2.0")
        rows = {}
        for number, cells in enumerate(workbook[SHEET].iter_rows(values_only=True, max_col=4), start=1):
            name, density, gravity, biblio_id = cells
            found = _middle_and_half(density, 1.0) or _middle_and_half(gravity, WATER_G_PER_ML)
            if name and found:
                rows[number] = FaoRow(number, str(name).strip(), *found, str(biblio_id or "").strip())
        return rows
    finally:
        workbook.close()


def _middle_and_half(cell: object, factor: float) -> tuple[float, float] | None:
    match = _NUMBER_OR_RANGE.match(str(cell)) if cell is not None else None
    if match is None:
        return None
    low, high = float(match[1]), float(match[2] or match[1])
    return (low + high) / 2.0 * factor, (high - low) / 2.0 * factor
