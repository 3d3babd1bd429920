"""The overview's charts as static/charts.js takes them: figures of the overview, no sum of their own."""

from collections.abc import Callable, Sequence
from typing import Any

from app.dashboard.data_pages.headline import Headline
from app.diary.distribution import Distribution
from app.diary.study_overview import OverviewDay

Chart = dict[str, Any]


def meals_chart(days: Sequence[OverviewDay]) -> Chart:
    """Meals a day."""
    return _of_days(
        days,
        "Meals per day",
        "",
        _series("Meals", [day.counts.meals for day in days], "series-1"),
        whole=True,
    )


def completeness_chart(days: Sequence[OverviewDay]) -> Chart:
    """Expected participants per day: closed, open with a meal, no entry; stacked."""
    return _of_days(
        days,
        "Participants per day: closed, open with a meal, no entry",
        "",
        _series("Closed", [day.counts.told_closed for day in days], "series-1"),
        _series("Open with a meal", [day.counts.told_open for day in days], "series-1", fill="hatched"),
        _series("No entry", [day.silent for day in days], "soft", fill="hollow"),
        whole=True,
        stacked=True,
    )


def late_chart(days: Sequence[OverviewDay]) -> Chart:
    """The share of a day's meals that came late, in percent, since it is read by people."""
    shares = [None if day.counts.late_share is None else 100 * day.counts.late_share for day in days]
    return _of_days(days, "Share of meals that came late", "%", _series("Late", shares, "series-2"), low=True)


def delay_chart(days: Sequence[OverviewDay]) -> Chart:
    """The median time from eating to arrival."""
    delays = [day.median_delay_seconds for day in days]
    return _of_days(days, "Median delay a day", "s", _series("Median delay", delays, "series-3", draw="line"), low=True)


def energy_chart(days: Sequence[OverviewDay]) -> Chart:
    """Mean energy over whole days, and over days left open, each with how many days it is of."""

    def of(name: str, value: Callable[[OverviewDay], Any], number: Callable[[OverviewDay], int], **looks: str) -> Chart:
        counts = [number(day) for day in days]
        return _series(name, [value(day) for day in days], **looks) | {"counts": counts}

    whole = of(
        "Whole days",
        lambda day: day.counts.whole_energy_kcal,
        lambda day: day.counts.whole,
        colour="series-1",
        draw="line",
    )
    left_open = of(
        "Open days, at least",
        lambda day: day.counts.open_energy_kcal,
        lambda day: day.counts.open_days,
        colour="series-2",
        draw="dashed",
    )
    return _of_days(days, "Mean energy of a participant's day", "kcal", whole, left_open)


def nutrient_chart(found: Distribution, headline: Headline) -> Chart:
    """How a nutrient lies over whole days, with its mean and median."""
    marks = [
        {"label": label, "at": at, "colour": colour, "dash": dash}
        for label, at, colour, dash in (
            ("mean", found.mean, "series-2", []),
            ("median", found.median, "series-3", [6, 4]),
        )
        if at is not None
    ]
    return {
        "kind": "bins",
        "edges": list(found.edges),
        "x_unit": headline.unit,
        "unit": "",
        "caption": f"{headline.name} of whole days, {headline.unit}",
        "whole": True,
        "stacked": False,
        "low": False,
        "series": [_series("Days", list(found.counts), "series-1")],
        "marks": marks,
    }


def _of_days(
    days: Sequence[OverviewDay],
    caption: str,
    unit: str,
    *series: Chart,
    whole: bool = False,
    stacked: bool = False,
    low: bool = False,
) -> Chart:
    return {
        "kind": "days",
        "labels": [day.counts.local_date.isoformat() for day in days],
        "unit": unit,
        "caption": caption,
        "whole": whole,
        "stacked": stacked,
        "low": low,
        "series": list(series),
        "marks": [],
    }


def _series(label: str, values: Sequence[Any], colour: str, draw: str = "bars", fill: str = "solid") -> Chart:
    return {
        "label": label,
        "values": list(values),
        "colour": colour,
        "draw": draw,
        "fill": fill,
        "counts": None,
    }
