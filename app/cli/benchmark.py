"""`tada benchmark FOLDER`: how far measures of weighed meals are off, and how often the intervals hold the truth."""

import csv
import json
import random
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import typer

from app.cli.database import JsonOption
from app.core.errors import InvalidInputError
from app.core.settings import Settings

FILE = "weighed.csv"
NEEDED = ("meal", "left", "food", "x", "y")
OPTIONAL = ("right", "marker", "camera", "grams", "ml")
DRAWS, TAIL = 1000, 25  # of meals; those beyond a 95 % interval on each side
NORMAL = 1.96
LEAST_MEALS = 3  # that an interval is told by


@dataclass(frozen=True, slots=True)
class WeighedFood:
    """One food. unit: g or ml. measured, low, high: None where it was not measured. code: why not, or its flags."""

    meal: str
    food: str
    unit: str
    weighed: float
    measured: float | None
    low: float | None
    high: float | None
    code: str

    @property
    def error(self) -> float | None:
        """Return measured over weighed, less one."""
        return None if self.measured is None else self.measured / self.weighed - 1

    @property
    def is_inside(self) -> bool:
        """Return whether the 90 % interval holds what was weighed."""
        return (
            self.low is not None and self.high is not None and self.low <= self.weighed <= self.high
        )


@dataclass(frozen=True, slots=True)
class Summary:
    """Per cent, with their 95 % intervals: mean size of errors, mean error, intervals that hold what was weighed."""

    name: str
    meals: int
    foods: int
    measured: int
    error: tuple[float, float, float] | None
    bias: tuple[float, float, float] | None
    inside: tuple[float, float, float] | None


def benchmark(
    folder: Annotated[
        Path, typer.Argument(help=f"Photographs, and {FILE} with a row for each food.")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="CSV of every food, to send on.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure weighed meals and say how far the measures are off, without a server."""
    rows = _read(folder)
    foods = [food for meal in _meals(rows) for food in _measured(folder, meal)]
    summaries = [
        summary(name, [food for food in foods if name in (food.food, "all")])
        for name in (*sorted({food.food for food in foods}), "all")
    ]
    if output is not None:
        with output.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, WeighedFood.__dataclass_fields__)
            writer.writeheader()
            writer.writerows(asdict(food) for food in foods)
    if as_json:
        print(
            json.dumps(
                {"foods": list(map(asdict, foods)), "summaries": list(map(asdict, summaries))}
            )
        )
    else:
        print(*_lines(summaries), sep="\n")


def summary(name: str, foods: Sequence[WeighedFood]) -> Summary:
    """Return the figures of foods; their intervals are by drawing meals again, and by Wilson's for a share."""
    errors = {
        meal: [food.error for food in of_meal if food.error is not None]
        for meal, of_meal in groupby(
            sorted(foods, key=lambda food: food.meal), lambda food: food.meal
        )
    }
    shown = [of_meal for of_meal in errors.values() if of_meal]
    count = sum(map(len, shown))
    if not shown:
        return Summary(name, 0, len(foods), 0, None, None, None)
    share = sum(food.is_inside for food in foods) / count
    middle = (share + NORMAL**2 / (2 * count)) / (1 + NORMAL**2 / count)
    half = (
        NORMAL
        / (1 + NORMAL**2 / count)
        * (share * (1 - share) / count + (NORMAL / count) ** 2 / 4) ** 0.5
    )
    return Summary(
        name,
        len(shown),
        len(foods),
        count,
        _drawn_again([[abs(error) for error in of_meal] for of_meal in shown]),
        _drawn_again(shown),
        (100 * share, 100 * (middle - half), 100 * (middle + half)),
    )


def _drawn_again(meals: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """The mean over all meals' foods, per cent, and its 95 % interval (bootstrap, Efron 1979)."""
    random_ = random.Random(0)  # noqa: S311  # draws the same meals each time
    means = sorted(_mean(random_.choices(meals, k=len(meals))) for _ in range(DRAWS))
    return _mean(meals), means[TAIL], means[-TAIL - 1]


def _mean(meals: Iterable[Sequence[float]]) -> float:
    return 100 * statistics.fmean(value for meal in meals for value in meal)


def _read(folder: Path) -> list[dict[str, str]]:
    try:
        with (folder / FILE).open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidInputError(f"{folder / FILE} cannot be read: {error}.") from None
    columns = reader.fieldnames or ()
    missing = [name for name in NEEDED if name not in columns]
    unknown = [name for name in columns if name not in NEEDED + OPTIONAL]
    if missing or unknown or not rows:
        raise InvalidInputError(
            f"{FILE} needs a row for each food, the columns {', '.join(NEEDED)}, and grams or ml; it may have "
            f"{', '.join(OPTIONAL)}. Missing: {', '.join(missing) or 'none'}; unknown: {', '.join(unknown) or 'none'}."
        )
    return rows


def _meals(rows: Sequence[dict[str, str]]) -> Iterator[list[dict[str, str]]]:
    for _, of_meal in groupby(sorted(rows, key=lambda row: row["meal"]), lambda row: row["meal"]):
        yield list(of_meal)


def _measured(folder: Path, rows: Sequence[Mapping[str, str]]) -> Iterator[WeighedFood]:
    """The foods of one meal's photographs."""
    from app.meals.estimate.estimate_files import estimate_files, read_options

    first, settings = rows[0], Settings()
    options = read_options(
        marker=first.get("marker") or None,
        camera=folder / first["camera"] if first.get("camera") else None,
        method="shape",
        hints=[
            json.dumps({"point": [_number(row, "x"), _number(row, "y")], "food": row["food"]})
            for row in rows
        ],
    )
    answer = estimate_files(
        [folder / first[side] for side in ("left", "right") if first.get(side)],
        options,
        max_pixels=settings.max_photo_pixels,
        debug=None,
        on_stage=None,
        index=settings.food_index,
    )
    items = {item["hint"]: item for item in answer["items"] if item["hint"] is not None}
    failure = answer["failure"]
    for number, row in enumerate(rows):
        yield _compared(row, items.get(number), failure["code"] if failure else "not_found")


def _compared(row: Mapping[str, str], item: Mapping[str, Any] | None, code: str) -> WeighedFood:
    name, unit = ("mass", "g") if row.get("grams") else ("volume", "ml")
    weighed = _number(row, "grams" if unit == "g" else "ml")
    if weighed <= 0:
        raise InvalidInputError(f"{FILE}: {row['food']} of meal {row['meal']} weighs nothing.")
    value, interval = None, None
    if item is not None:
        value, interval, code = (
            item[f"{name}_{unit}"],
            item[f"{name}_interval_{unit}"],
            " ".join(item["flags"]),
        )
    low, high = interval or (None, None)
    return WeighedFood(row["meal"], row["food"], unit, weighed, value, low, high, code)


def _number(row: Mapping[str, str], column: str) -> float:
    try:
        return float(row.get(column) or "")
    except ValueError:
        raise InvalidInputError(
            f"{FILE}: {column} of {row['food']}, meal {row['meal']}, is no number: {row.get(column) or 'empty'}."
        ) from None


def _lines(summaries: Sequence[Summary]) -> Iterator[str]:
    yield "| food | weighed | measured | mean error, % | bias, % | inside, % |"
    yield "|---|---|---|---|---|---|"
    for each in summaries:
        is_told = each.meals >= LEAST_MEALS
        figures = [
            ""
            if figure is None
            else f"{figure[0]:.1f}" + (f" ({figure[1]:.1f} to {figure[2]:.1f})" if is_told else "")
            for figure in (each.error, each.bias, each.inside)
        ]
        yield f"| {each.name} | {each.foods} | {each.measured} | {' | '.join(figures)} |"
