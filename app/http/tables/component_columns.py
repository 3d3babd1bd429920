"""Columns of components: one each in the wide layout, a row each in the long one."""

from collections.abc import Sequence
from dataclasses import dataclass

from app.http.tables.columns import Column, Part
from app.http.tables.record_columns import HEADLINES, NO_CONTENT

NO_SUM = "It is known of nothing that was eaten. Never 0."
COVERAGE = (
    "The share of the eaten grams for which {name} is known, 0 to 1: below 1, the sum is of a part of what was eaten."
)
NO_COVERAGE = "Grams of something that was eaten are not known, so nobody knows how much of it the sum tells."


@dataclass(frozen=True, slots=True)
class ComponentColumn:
    """A component as a table has it. numbers: of the component, or of several that stand for it, the best first."""

    column: Column
    numbers: tuple[str, ...]
    tagname: str | None
    title: str

    @property
    def of_long_row(self) -> tuple[str | None, ...]:
        """The values of OF_COMPONENT."""
        return self.column.name, self.numbers[0], self.tagname, self.title, self.column.unit


def component_column(
    number: str, title: str, unit: str, tagname: str | None, expression: str | None
) -> ComponentColumn:
    """Named by INFOODS tagname and unit (FE_mg), without a tagname by its number (component_573_mg)."""
    name = f"{tagname}_{unit}" if tagname is not None else f"component_{number}_{unit}"
    how = f" ({expression})" if expression else ""
    meaning = f"{title}{how}, component {number}, in what was eaten (consumed_g)."
    return ComponentColumn(Column(name, "number", unit, meaning, empty=NO_CONTENT), (number,), tagname, title)


def headline_columns(numbers: Sequence[tuple[str, ...]], of: Sequence[tuple[str | None, str]]) -> list[ComponentColumn]:
    """The ten that a record has itself. numbers: of each in their order; of: tagname and name of each."""
    return [
        ComponentColumn(column, column_numbers, tagname, title)
        for column, column_numbers, (tagname, title) in zip(HEADLINES, numbers, of, strict=True)
    ]


def wide_part(components: Sequence[ComponentColumn]) -> Part:
    """A column a component: of an item."""
    return Part("numbers", tuple(component.column for component in components))


def wide_sums(components: Sequence[ComponentColumn]) -> Part:
    """Two columns a component: the sum over what was eaten, and of which share of the grams it is known."""
    columns: list[Column] = []
    for one in components:
        name, unit = one.column.name, one.column.unit
        columns += [
            Column(name, "number", unit, f"Sum of {one.title} over what was eaten.", empty=NO_SUM),
            coverage_column(f"{name}_coverage", name),
        ]
    return Part("numbers", tuple(columns))


def headline_sums(empty: str) -> Part:
    """The same of the ten components that a record holds itself, over records that hold. empty: why a sum may be."""
    columns: list[Column] = []
    for one in HEADLINES:
        columns += [
            Column(one.name, "number", one.unit, f"Sum of {one.name} over records that hold.", empty=empty),
            coverage_column(f"{one.name}_coverage", one.name),
        ]
    return Part("numbers", tuple(columns))


def coverage_column(name: str, of: str) -> Column:
    """The column beside a sum."""
    return Column(name, "number", "1", COVERAGE.format(name=of), empty=NO_COVERAGE)


OF_COMPONENT = Part(
    "shared",
    (
        Column("component", "word", meaning="The column that the component has in the wide layout."),
        Column("number", "word", meaning="USDA's number of the component, or its tagname where USDA has none."),
        Column("tagname", "word", meaning="Its INFOODS tagname.", empty="INFOODS has none."),
        Column("component_name", "word", meaning="Its name."),
        Column("unit", "word", meaning="The unit of amount (and per_100_g)."),
    ),
)
LONG_AMOUNT = Part(
    "numbers",
    (
        Column("amount", "number", None, "How much of it was eaten, in `unit`.", empty=NO_CONTENT),
        Column(
            "per_100_g",
            "number",
            None,
            "Content of 100 g edible portion of this version of the food, in `unit`.",
            empty="The food table does not know it, or there is no food. Never 0.",
        ),
    ),
)
LONG_SUM = Part(
    "numbers",
    (
        Column("amount", "number", None, "Sum over what was eaten, in `unit`.", empty=NO_SUM),
        coverage_column("coverage", "it"),
    ),
)
KNOWN = Part("shared", (Column("known", "boolean", meaning="Whether amount is known; where not, it is empty."),))
