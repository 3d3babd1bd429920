"""The overview's charts in the form that static/charts.js takes; only percentages are computed here."""

from collections.abc import Sequence
from dataclasses import dataclass

from app.diary.distribution import Distribution
from app.diary.overview_schemas import OverviewDayOut
from app.nutrition.components import Headline


@dataclass(frozen=True, slots=True)
class Series:
    """A series of values, None for gaps. counts: the number of days behind each value."""

    label: str
    values: Sequence[float | None]
    colour: str
    draw: str = "bars"
    fill: str = "solid"
    counts: Sequence[int] | None = None


@dataclass(frozen=True, slots=True)
class Mark:
    """A vertical line at a value of the x axis."""

    label: str
    at: float
    colour: str
    dash: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """A chart of days (labels) or of bins (edges). whole: no fractions on the y axis. low: of small height."""

    kind: str = "days"
    caption: str
    series: Sequence[Series]
    unit: str = ""
    labels: Sequence[str] = ()
    edges: Sequence[float] = ()
    x_unit: str = ""
    whole: bool = False
    stacked: bool = False
    low: bool = False
    marks: Sequence[Mark] = ()


def day_charts(days: Sequence[OverviewDayOut]) -> dict[str, Chart]:
    """Return name -> chart of the window's days."""
    labels = [day.local_date.isoformat() for day in days]
    late = [None if day.late_share is None else 100 * day.late_share for day in days]
    return {
        "meals": Chart(
            caption="Meals per day",
            labels=labels,
            series=[Series("Meals", [day.meals for day in days], "series-1")],
            whole=True,
        ),
        "completeness": Chart(
            caption="Participants per day: closed, open with a meal, no entry",
            labels=labels,
            series=[
                Series("Closed", [day.told_closed for day in days], "series-1"),
                Series(
                    "Open with a meal", [day.told_open for day in days], "series-1", fill="hatched"
                ),
                Series("No entry", [day.silent for day in days], "soft", fill="hollow"),
            ],
            whole=True,
            stacked=True,
        ),
        "late": Chart(
            caption="Share of meals that came late",
            unit="%",
            labels=labels,
            series=[Series("Late", late, "series-2")],
            low=True,
        ),
        "delay": Chart(
            caption="Median delay per day",
            unit="s",
            labels=labels,
            series=[
                Series(
                    "Median delay", [day.median_delay_seconds for day in days], "series-3", "line"
                )
            ],
            low=True,
        ),
        "energy": Chart(
            caption="Mean energy of a participant's day",
            unit="kcal",
            labels=labels,
            series=[
                Series(
                    "Whole days",
                    [day.whole_energy_kcal for day in days],
                    "series-1",
                    "line",
                    counts=[day.whole for day in days],
                ),
                Series(
                    "Open days, at least",
                    [day.open_energy_kcal for day in days],
                    "series-2",
                    "dashed",
                    counts=[day.open_days for day in days],
                ),
            ],
        ),
    }


def nutrient_chart(nutrient: Distribution, headline: Headline) -> Chart:
    """Return the distribution of a nutrient over whole days, with its mean and median."""
    marks = []
    if nutrient.mean is not None:
        marks.append(Mark("mean", nutrient.mean, "series-2", ()))
    if nutrient.median is not None:
        marks.append(Mark("median", nutrient.median, "series-3", (6, 4)))
    return Chart(
        kind="bins",
        caption=f"{headline.label} of whole days, {headline.unit}",
        edges=nutrient.edges,
        x_unit=headline.unit,
        series=[Series("Days", nutrient.counts, "series-1")],
        whole=True,
        marks=marks,
    )
