"""Columns of components: one each in the wide layout, a row each in the long one."""

from collections.abc import Iterable
from dataclasses import dataclass

from app.http.columns.dictionary import Column
from app.http.columns.record_columns import AMOUNTS_OF_HEADLINES, NO_CONTENT
from app.nutrition.components import COMPONENT_BY_NUMBER, HEADLINES

NO_SUM = "It is known of nothing that was eaten. Never 0."
COVERAGE = (
    "The share of the eaten grams for which {name} is known, 0 to 1: "
    "below 1, the sum is of a part of what was eaten."
)
NO_COVERAGE = (
    "Grams of something that was eaten are not known, so nobody knows how much of it the sum tells."
)


@dataclass(frozen=True, slots=True)
class ComponentColumn:
    """A component as a table has it.

    numbers: USDA's, of the component or of several that stand for it, the best first.
    """

    column: Column
    numbers: tuple[str, ...]
    tagname: str | None
    title: str


def component_column(
    number: str, title: str, unit: str, tagname: str | None, expression: str | None
) -> ComponentColumn:
    """Named by INFOODS tagname and unit (FE_mg), without a tagname by number (component_573_mg)."""
    name = f"{tagname}_{unit}" if tagname is not None else f"component_{number}_{unit}"
    how = f" ({expression})" if expression else ""
    meaning = f"{title}{how}, component {number}, in what was eaten (consumed_g)."
    column = Column(name, "number", meaning, unit, empty=NO_CONTENT)
    return ComponentColumn(column, (number,), tagname, title)


def _headline(column: Column, numbers: tuple[str, ...]) -> ComponentColumn:
    component = COMPONENT_BY_NUMBER[numbers[0]]
    return ComponentColumn(column, numbers, component.tagname, component.name)


HEADLINE_COMPONENTS = tuple(
    _headline(column, headline.numbers)
    for column, headline in zip(AMOUNTS_OF_HEADLINES, HEADLINES, strict=True)
)


def sum_columns(components: Iterable[ComponentColumn]) -> tuple[Column, ...]:
    """Two columns a component: its sum over what was eaten, and how much of it the sum tells."""
    columns: list[Column] = []
    for component in components:
        name = component.column.name
        meaning = f"Sum of {component.title} over what was eaten."
        columns.append(Column(name, "number", meaning, component.column.unit, empty=NO_SUM))
        columns.append(coverage_column(f"{name}_coverage", name))
    return tuple(columns)


def headline_sums(empty: str) -> tuple[Column, ...]:
    """The same of the components that a record holds. empty: why a sum may be."""
    columns: list[Column] = []
    for headline in HEADLINES:
        name, unit = headline.column, headline.unit
        columns.append(
            Column(name, "number", f"Sum of {name} over records that hold.", unit, empty=empty)
        )
        columns.append(coverage_column(f"{name}_coverage", name))
    return tuple(columns)


def coverage_column(name: str, of: str) -> Column:
    """The column beside a sum."""
    return Column(name, "number", COVERAGE.format(name=of), "1", empty=NO_COVERAGE)


OF_COMPONENT = (
    Column("component", "word", "The column that the component has in the wide layout."),
    Column("number", "word", "USDA's number of the component, or its tagname where USDA has none."),
    Column("tagname", "word", "Its INFOODS tagname.", empty="INFOODS has none."),
    Column("component_name", "word", "Its name."),
    Column("unit", "word", "The unit of amount (and per_100_g)."),
)
LONG_AMOUNT = (
    Column("amount", "number", "How much of it was eaten, in `unit`.", empty=NO_CONTENT),
    Column(
        "per_100_g",
        "number",
        "Content of 100 g edible portion of this version of the food, in `unit`.",
        empty="The food table does not know it, or there is no food. Never 0.",
    ),
)
LONG_SUM = (
    Column("amount", "number", "Sum over what was eaten, in `unit`.", empty=NO_SUM),
    coverage_column("coverage", "it"),
)
KNOWN = Column("known", "boolean", "Whether amount is known; where not, it is empty.")
