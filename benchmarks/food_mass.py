"""How good the food table's densities are: mass from true volume, over the measured specimens of ECUSTFD.

    python benchmarks/food_mass.py [--markdown] [--data FOLDER]

Reads photos/ecustfd/density.xls of FOLDER (by default TADA_SHARED_DATA or ../shared), which needs xlrd (dev extra). The
true volume of each specimen times the density that the table chooses for the food, against the specimen's mass. Most of
these densities are the medians of these very specimens, so each is also predicted by the median of the others.
"""

import argparse
import math
import os
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.nutrition.density import resolve_density
from app.nutrition.doubt import Doubt, estimate
from app.nutrition.foods import Density, load_starter_table
from tools.ecustfd import WHOLE_FRUIT, Specimen, is_possible, read_specimens

ROOT = Path(__file__).resolve().parents[1]
TARGET_PERCENT = 9.0  # mean over the foods below that are whole fruit or eggs
EGG = "egg"
TABLE_FOODS = {  # sheet of density.xls -> key of the starter table
    "apple": "apple",
    "banana": "banana",
    "grape": "grapes",
    "lemon": "lemon",
    "litchi": "litchi",
    "mango": "mango",
    "orange": "orange",
    "peach": "peach",
    "pear": "pear",
    "plum": "plum",
    "qiwi": "kiwifruit",
    "tomato": "tomato",
    EGG: "egg-boiled",
    "bread": "bread-white",
    "bun": "steamed-bun",
    "doughnut": "doughnut",
    "fired_dough_twist": "fried-dough-twist",
}


@dataclass(frozen=True)
class FoodErrors:
    """One food's specimens against the table.

    others_percent: each predicted by the median of the others. inside: how many lie in the density's 90 % interval.
    """

    sheet: str
    key: str
    density: Density
    kept: Sequence[Specimen]
    excluded: Sequence[Specimen]
    table_percent: float
    floor_percent: float
    others_percent: float
    inside: int

    @property
    def counts_for_the_bar(self) -> bool:
        return self.sheet in WHOLE_FRUIT or self.sheet == EGG


def food_errors(
    sheet: str, key: str, specimens: Sequence[Specimen], density: Density
) -> FoodErrors:
    """Mean absolute errors of the predicted mass, percent, over the possible specimens; needs two of them."""
    kept = [specimen for specimen in specimens if is_possible(sheet, specimen)]
    excluded = [specimen for specimen in specimens if not is_possible(sheet, specimen)]
    median = statistics.median(specimen.g_per_ml for specimen in kept)
    medians_of_others = [
        statistics.median(other.g_per_ml for other in kept if other is not specimen)
        for specimen in kept
    ]
    return FoodErrors(
        sheet,
        key,
        density,
        kept,
        excluded,
        _mean_error_percent(kept, [density.g_per_ml] * len(kept)),
        _mean_error_percent(kept, [median] * len(kept)),
        _mean_error_percent(kept, medians_of_others),
        sum(_is_inside(density, specimen) for specimen in kept),
    )


def _is_inside(density: Density, specimen: Specimen) -> bool:
    predicted = estimate(
        density.g_per_ml * specimen.volume_ml, Doubt(0.0, density.relative_sd, 0.0)
    )
    return predicted.low <= specimen.mass_g <= predicted.high


def _mean_error_percent(specimens: Sequence[Specimen], g_per_ml: Sequence[float]) -> float:
    return 100.0 * statistics.fmean(
        abs(density * specimen.volume_ml / specimen.mass_g - 1.0)
        for specimen, density in zip(specimens, g_per_ml, strict=True)
    )


def all_errors(specimens: Mapping[str, Sequence[Specimen]]) -> list[FoodErrors]:
    table = load_starter_table()
    found = []
    for sheet, key in TABLE_FOODS.items():
        choice = resolve_density(
            table.food(key), form="whole"
        )  # single pieces, grapes and bread too
        assert choice is not None
        found.append(food_errors(sheet, key, specimens[sheet], choice.chosen))
    return found


def over_the_bar(errors: Sequence[FoodErrors]) -> Mapping[str, float]:
    """Mean errors over whole fruit and eggs, percent: of the foods' means, and of all specimens alike."""
    counting = [food for food in errors if food.counts_for_the_bar]
    specimens = math.fsum(len(food.kept) for food in counting)
    return {
        "foods": statistics.fmean(food.table_percent for food in counting),
        "specimens": math.fsum(food.table_percent * len(food.kept) for food in counting)
        / specimens,
        "floor": math.fsum(food.floor_percent * len(food.kept) for food in counting) / specimens,
        "others": math.fsum(food.others_percent * len(food.kept) for food in counting) / specimens,
    }


def lines(errors: Sequence[FoodErrors], specimens: Mapping[str, Sequence[Specimen]]) -> list[str]:
    head = (
        "ECUSTFD",
        "table",
        "n",
        "out",
        "g/ml",
        "from",
        "table %",
        "own median %",
        "others' median %",
        "in 90 %",
    )
    rows = [head, ("---",) * 2 + ("---:",) * 3 + ("---",) + ("---:",) * 4]
    for food in sorted(errors, key=lambda food: (not food.counts_for_the_bar, food.sheet)):
        density = food.density
        rows.append((
            food.sheet, food.key, str(len(food.kept)), str(len(food.excluded)), f"{density.g_per_ml:.3f}",
            density.source.split(" (")[0].split(",")[0], f"{food.table_percent:.1f}", f"{food.floor_percent:.1f}",
            f"{food.others_percent:.1f}", f"{food.inside} of {len(food.kept)}",
        ))  # fmt: skip
    means = over_the_bar(errors)
    verdict = "met" if means["specimens"] <= TARGET_PERCENT else "missed"
    excluded = "; ".join(
        f"{specimen.name} ({specimen.mass_g:g} g in {specimen.volume_ml:g} ml: {specimen.g_per_ml:.2f})"
        for food in errors
        for specimen in food.excluded
    )
    summary = (
        f"Whole fruit and eggs: {means['specimens']:.1f} % over the specimens, {means['foods']:.1f} % over the foods; "
        f"target {TARGET_PERCENT:g} %: {verdict}. With each food's own median {means['floor']:.1f} %, with the median "
        f"of the other specimens {means['others']:.1f} %."
    )
    return [
        *("| " + " | ".join(row) + " |" for row in rows),
        "",
        summary,
        "",
        f"Left out, as whole fruit is between 0.65 and 1.15 g/ml: {excluded}.",
        "",
        f"Without a food in the table: {', '.join(sorted(set(specimens) - set(TABLE_FOODS)))}.",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python benchmarks/food_mass.py", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    options = parser.parse_args()
    specimens = read_specimens(options.data / "photos" / "ecustfd" / "density.xls")
    found = all_errors(specimens)
    if options.markdown:
        print("\n".join(lines(found, specimens)))
        return
    for food in found:
        print(f"{food.sheet:18} {food.table_percent:5.1f} % of {len(food.kept)} specimens")
    print(f"whole fruit and eggs {over_the_bar(found)['specimens']:.1f} %")


if __name__ == "__main__":
    main()
