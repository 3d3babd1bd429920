"""`tada benchmark FOLDER`: how far measures of weighed meals are off, and how often the intervals hold the truth."""

import csv
import json
import math
import random
import statistics
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.cli.database import JsonOption
from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.core.shares import wilson_interval

if TYPE_CHECKING:
    from app.vision.model import EstimateOptions

Row = Mapping[str, str]
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
    foods = [
        food
        for photographs, of_same in groupby(sorted(rows, key=_photographs), key=_photographs)
        for food in _measured(folder, photographs, list(of_same))
    ]
    summaries = [
        summary(name, [food for food in foods if name in (food.food, "all")])
        for name in (*sorted({food.food for food in foods}), "all")
    ]
    if output is not None:
        with output.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, WeighedFood.__dataclass_fields__)
            writer.writeheader()
            writer.writerows(map(asdict, foods))
    if as_json:
        print(
            json.dumps(
                {
                    "foods": [asdict(food) for food in foods],
                    "summaries": [asdict(line) for line in summaries],
                }
            )
        )
    else:
        print(*_lines(summaries), sep="\n")


def summary(name: str, foods: Sequence[WeighedFood]) -> Summary:
    """Return the figures of foods.

    Their intervals are by drawing meals again, those of a share by Wilson's formula.
    """
    errors = defaultdict(list)
    for food in foods:
        if food.error is not None:
            errors[food.meal].append(food.error)
    meals = list(errors.values())
    count = sum(map(len, meals))
    if not meals:
        return Summary(name, 0, len(foods), 0, None, None, None)
    share = sum(food.is_inside for food in foods) / count
    low, high = wilson_interval(share, count, NORMAL)
    return Summary(
        name,
        len(meals),
        len(foods),
        count,
        _drawn_again([[abs(error) for error in of_meal] for of_meal in meals]),
        _drawn_again(meals),
        (100 * share, 100 * low, 100 * high),
    )


def _drawn_again(meals: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Return the mean over all meals' foods, per cent, and its 95 % interval.

    By the bootstrap (Efron, 1979).
    """
    random_ = random.Random(0)  # noqa: S311  # draws the same meals each time
    means = sorted(_mean(random_.choices(meals, k=len(meals))) for _ in range(DRAWS))
    return _mean(meals), means[TAIL], means[-TAIL - 1]


def _mean(meals: Iterable[Sequence[float]]) -> float:
    return 100 * statistics.fmean(value for meal in meals for value in meal)


def _read(folder: Path) -> list[Row]:
    """Return the table's rows, in which nothing is wrong that would end the run half way."""
    try:
        with (folder / FILE).open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            rows: list[Row] = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidInputError(f"{folder / FILE} cannot be read: {error}.") from None
    columns = reader.fieldnames or ()
    missing = [name for name in NEEDED if name not in columns]
    unknown = [name for name in columns if name not in NEEDED + OPTIONAL]
    if missing or unknown or not rows:
        raise InvalidInputError(
            f"{FILE} needs a row for each food, with {', '.join(NEEDED)}, and grams or ml; it may have "
            f"{', '.join(OPTIONAL)}. Missing: {', '.join(missing) or 'none'}; "
            f"unknown: {', '.join(unknown) or 'none'}."
        )
    for row in rows:
        _options(folder, [row])
        if _weighed(row) <= 0:
            raise InvalidInputError(f"{FILE}: {row['food']} of meal {row['meal']} weighs nothing.")
        for name in filter(None, _photographs(row)[:2]):
            if not (folder / name).is_file():
                raise InvalidInputError(f"{FILE}: there is no photograph {folder / name}.")
    return rows


def _photographs(row: Row) -> tuple[str, ...]:
    return tuple(row.get(name) or "" for name in ("left", "right", "marker", "camera"))


def _options(folder: Path, rows: Sequence[Row]) -> "EstimateOptions":
    """Return the options of one estimate. Raises InvalidInputError."""
    from app.meals.estimate.estimate_files import read_options, require_foods

    camera = rows[0].get("camera")
    options = read_options(
        marker=rows[0].get("marker") or None,
        camera=folder / camera if camera else None,
        method="shape",
        hints=[
            json.dumps({"point": [_number(row, "x"), _number(row, "y")], "food": row["food"]})
            for row in rows
        ],
    )
    require_foods(options)
    return options


def _measured(
    folder: Path, photographs: Sequence[str], rows: Sequence[Row]
) -> Iterator[WeighedFood]:
    """Yield the foods of the same photographs."""
    from app.meals.estimate.estimate_files import estimate_files

    settings = Settings()
    answer = estimate_files(
        [folder / name for name in photographs[:2] if name],
        _options(folder, rows),
        max_pixels=settings.max_photo_pixels,
        debug=None,
        on_stage=None,
        index=settings.food_index,
    )
    items = {item["hint"]: item for item in answer["items"]}
    failure = answer["failure"]
    for number, row in enumerate(rows):
        yield _compared(row, items.get(number), failure["code"] if failure else "not_found")


def _compared(row: Row, item: Mapping[str, Any] | None, code: str) -> WeighedFood:
    name, unit = ("mass", "g") if row.get("grams") else ("volume", "ml")
    value, interval = None, None
    if item is not None:
        value, interval = item[f"{name}_{unit}"], item[f"{name}_interval_{unit}"]
        code = " ".join(item["flags"])
    low, high = interval or (None, None)
    return WeighedFood(row["meal"], row["food"], unit, _weighed(row), value, low, high, code)


def _weighed(row: Row) -> float:
    return _number(row, "grams" if row.get("grams") else "ml")


def _number(row: Row, column: str) -> float:
    text = row.get(column) or "empty"
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InvalidInputError(
            f"{FILE}: {column} of {row['food']}, meal {row['meal']}, is no number: {text}."
        )
    return number


def _lines(summaries: Sequence[Summary]) -> Iterator[str]:
    yield "| food | weighed | measured | mean error, % | bias, % | inside, % |"
    yield "|---|---|---|---|---|---|"
    for line in summaries:
        is_told = line.meals >= LEAST_MEALS
        figures = [
            ""
            if figure is None
            else f"{figure[0]:.1f}" + (f" ({figure[1]:.1f} to {figure[2]:.1f})" if is_told else "")
            for figure in (line.error, line.bias, line.inside)
        ]
        yield f"| {line.name} | {line.foods} | {line.measured} | {' | '.join(figures)} |"
