"""The filters of a study's meals in the page's address: those of `GET /v1/meals`, by its names; blank means unset."""

from dataclasses import dataclass
from typing import Annotated, Literal, TypeVar

from fastapi import Depends, Query
from pydantic import BeforeValidator

from app.dashboard.forms import Blank
from app.exports.export_files import MOST_VALUES, Code, FoodKey, meal_filter
from app.exports.export_spec import FILTERS, Rows
from app.http.paging import reversed_range_message
from app.http.row_filter import RowFilter
from app.http.text_schemas import LocalDay
from app.meals.stored.models import AfterStatus, MealStatus

Origin = Literal["photographed", "declared"]
Needs = Literal["review", "answer"]
Order = Literal["newest", "oldest", "doubt"]
View = Literal["gallery", "table"]


def _without_blanks(values: object) -> object:
    return [value for value in values if str(value).strip()] if isinstance(values, list) else values


Value = TypeVar("Value")
Blanks = BeforeValidator(_without_blanks)
MORE = (
    "statuses",
    "flags",
    "origin",
    "needs",
    "failure_codes",
    "after_statuses",
)  # below the form's first row


@dataclass(frozen=True, slots=True)
class MealFilters:
    """The validated filters, order and view."""

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
        """How many filters are set that the form hides at first."""
        return len([name for name in self.filters.set_names if name in MORE])

    @property
    def wrong_days(self) -> str | None:
        """A sentence if the first day is after the last."""
        return reversed_range_message(self.filters.first_day, self.filters.last_day)

    def reaches(self, rows: Rows) -> bool:
        """Whether a file of these rows supports all filters that are set. An item's status is not the meal's."""
        names = set(self.filters.set_names)
        return names <= set(FILTERS[rows]) and (rows != "items" or "statuses" not in names)


def meal_filters(
    study: str,
    participant: Annotated[str | None, Query(max_length=64), Blank] = None,
    first_day: Annotated[LocalDay | None, Query(alias="from"), Blank] = None,
    last_day: Annotated[LocalDay | None, Query(alias="to"), Blank] = None,
    status: Annotated[list[MealStatus] | None, Query(max_length=7), Blanks] = None,
    origin: Annotated[Origin | None, Query(), Blank] = None,
    failure: Annotated[list[Code] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    after_status: Annotated[list[AfterStatus] | None, Query(max_length=7), Blanks] = None,
    food: Annotated[list[FoodKey] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    flag: Annotated[list[Code] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    needs: Annotated[Needs | None, Query(), Blank] = None,
    order: Annotated[Order | None, Query(), Blank] = None,
    view: View = "gallery",
) -> MealFilters:
    """Read the address's parameters, which FastAPI validates."""
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
