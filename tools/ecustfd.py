"""ECUSTFD (Liang and Li 2017): volume and mass of each photographed specimen -> each food's measured density.

    python -m tools.ecustfd density.xls > tools/starter_table/ecustfd.csv

density.xls has one sheet per food: id, type, volume, weight. Its header says mm3, the figures are millilitres, rounded
to 10. Some whole fruit are impossible (oranges of 1.38 g/ml): those outside 0.65 to 1.15 are counted and left out. The
medians are committed; the workbook itself is not ours to pass on. Reading it needs xlrd, of the dev extra.
"""

import csv
import importlib
import io
import sys
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from app.nutrition.portion_density import Specimen, median_density

VOLUME_STEP_ML = 10.0
POSSIBLE_FRUIT_G_PER_ML = (0.65, 1.15)
WHOLE_FRUIT = frozenset({
    "apple", "banana", "grape", "lemon", "litchi", "mango", "orange", "peach", "pear", "plum", "qiwi", "tomato",
})  # fmt: skip
_MIXED_SHEET = "mix"  # pairs of specimens that are in their own sheets too


@dataclass(frozen=True, slots=True)
class MeasuredDensity:
    """A food's density over its specimens. excluded: how many could not be and were left out."""

    food: str
    specimens: int
    excluded: int
    g_per_ml: float
    sd_g_per_ml: float


def read_specimens(path: Path) -> Mapping[str, list[Specimen]]:
    """density.xls -> food -> specimens. Needs xlrd, of the dev extra. Raises ValueError if the columns are others."""
    try:
        xlrd = importlib.import_module("xlrd")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "reading density.xls needs xlrd, which is in the dev extra"
        ) from error
    specimens: dict[str, list[Specimen]] = {}
    for sheet in xlrd.open_workbook(path).sheets():
        if sheet.name == _MIXED_SHEET:
            continue
        rows = [sheet.row_values(row) for row in range(sheet.nrows)]
        if rows[0][0] != "id" or not str(rows[0][2]).startswith("volume"):
            raise ValueError(
                f"{path}, sheet {sheet.name}, line 1: {rows[0]} where id, type, volume, weight is expected"
            )
        specimens[sheet.name] = [
            Specimen(row[0], row[2], row[3]) for row in rows[1:] if row[0] and row[2]
        ]
    return specimens


def measured_density(food: str, specimens: Sequence[Specimen]) -> MeasuredDensity:
    """The median density of the possible specimens, and what the next one may differ from it (median_density).

    Raises ValueError if fewer than two are possible.
    """
    kept = [specimen for specimen in specimens if is_possible(food, specimen)]
    if len(kept) < 2:
        raise ValueError(f"{food}: {len(kept)} specimens are possible; a spread takes two")
    g_per_ml, sd_g_per_ml = median_density(kept, volume_step_ml=VOLUME_STEP_ML)
    return MeasuredDensity(
        food, len(kept), len(specimens) - len(kept), round(g_per_ml, 3), round(sd_g_per_ml, 3)
    )


def is_possible(food: str, specimen: Specimen) -> bool:
    """Whether the specimen of this sheet can be: whole fruit is between 0.65 and 1.15 g/ml."""
    low, high = POSSIBLE_FRUIT_G_PER_ML
    return food not in WHOLE_FRUIT or low <= specimen.g_per_ml <= high


def write_measured(measured: Sequence[MeasuredDensity]) -> str:
    """The densities as CSV, with a header."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(field.name for field in fields(MeasuredDensity))
    writer.writerows(astuple(density) for density in measured)
    return text.getvalue()


def read_measured(text: str) -> Mapping[str, MeasuredDensity]:
    """What write_measured wrote -> food -> density."""
    return {
        row["food"]: MeasuredDensity(
            row["food"],
            int(row["specimens"]),
            int(row["excluded"]),
            float(row["g_per_ml"]),
            float(row["sd_g_per_ml"]),
        )
        for row in csv.DictReader(io.StringIO(text))
    }


if __name__ == "__main__":
    specimens_by_food = read_specimens(Path(sys.argv[1]))
    sys.stdout.write(
        write_measured([measured_density(*item) for item in specimens_by_food.items()])
    )
