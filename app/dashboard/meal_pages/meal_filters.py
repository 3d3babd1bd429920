"""The filters of a study's meals as they stand in the address: those of `GET /v1/meals`, by its names.

A form sends a field that says nothing as ""; that is the same as no field.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from fastapi import Depends, Query
from pydantic import BeforeValidator

from app.exports.export_files import MOST_VALUES, FoodKey, Word, meal_filter
from app.exports.export_spec import FILTERS, Rows
from app.http.paging import told_reversed
from app.http.row_filter import RowFilter
from app.http.text_schemas import LocalDay
from app.meals.models import AfterStatus, MealStatus

Origin = Literal["photographed", "declared"]
Needs = Literal["review", "answer"]
Order = Literal["newest", "oldest"]
View = Literal["gallery", "table"]


def _without_blanks(told: Any) -> Any:
    return [one for one in told if str(one).strip()] if isinstance(told, list) else told


Value = TypeVar("Value")
Blank = BeforeValidator(lambda told: None if isinstance(told, str) and not told.strip() else told)
Blanks = BeforeValidator(_without_blanks)
MORE = ("statuses", "flags", "origin", "needs", "failure_codes", "after_statuses")  # behind the form's first row


@dataclass(frozen=True, slots=True)
class MealFilters:
    """What was asked for, checked."""

    study: str
    filters: RowFilter
    order: Order
    view: View

    @property
    def is_any(self) -> bool:
        """Whether any filter is set."""
        return len(self.filters.set_names) > 1

    @property
    def more(self) -> int:
        """How many are set of those that are not always in view."""
        return len([name for name in self.filters.set_names if name in MORE])

    @property
    def told_reversed(self) -> str | None:
        """What to say where the first day lies after the last."""
        return told_reversed(self.filters.first_day, self.filters.last_day)

    def reaches(self, rows: Rows) -> bool:
        """Whether a file of these rows can have all filters that are set. An item has a status of its own."""
        names = set(self.filters.set_names)
        return names <= set(FILTERS[rows]) and (rows != "items" or "statuses" not in names)


def meal_filters(
    study: str,
    participant: Annotated[str | None, Query(max_length=64), Blank] = None,
    first_day: Annotated[LocalDay | None, Query(alias="from"), Blank] = None,
    last_day: Annotated[LocalDay | None, Query(alias="to"), Blank] = None,
    status: Annotated[list[MealStatus] | None, Query(max_length=7), Blanks] = None,
    origin: Annotated[Origin | None, Query(), Blank] = None,
    failure: Annotated[list[Word] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    after_status: Annotated[list[AfterStatus] | None, Query(max_length=7), Blanks] = None,
    food: Annotated[list[FoodKey] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    flag: Annotated[list[Word] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    needs: Annotated[Needs | None, Query(), Blank] = None,
    order: Annotated[Order | None, Query(), Blank] = None,
    view: View = "gallery",
) -> MealFilters:
    """The address's parameters; FastAPI refuses what is none."""
    code = participant.strip() if participant is not None else None
    filters = meal_filter(
        RowFilter(study, code, first_day, last_day),
        status=_each_once(status),
        origin=origin,
        failure=_each_once(failure),
        after_status=_each_once(after_status),
        food=_each_once(food),
        flag=_each_once(flag),
        needs=needs,
    )
    return MealFilters(study, filters, order or "newest", view)


Filters = Annotated[MealFilters, Depends(meal_filters)]


def _each_once(values: list[Value] | None) -> list[Value]:
    return list(dict.fromkeys(values or ()))
