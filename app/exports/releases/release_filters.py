"""Which data a release freezes."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Annotated

from pydantic import Field, JsonValue, TypeAdapter


@dataclass(frozen=True, slots=True)
class ReleaseFilters:
    """Local days, both included, and statuses of items; None or an empty tuple is no filter."""

    first_day: Annotated[date | None, Field(alias="from")] = None
    last_day: Annotated[date | None, Field(alias="to")] = None
    statuses: tuple[str, ...] = ()

    def as_json(self) -> dict[str, JsonValue]:
        """Return the filters as JSON values."""
        values: dict[str, JsonValue] = FILTERS.dump_python(self, mode="json", by_alias=True)
        return values


FILTERS = TypeAdapter(ReleaseFilters)


def filters_of_json(values: Mapping[str, JsonValue]) -> ReleaseFilters:
    """Return the filters that `as_json` stored."""
    return FILTERS.validate_python(values)
