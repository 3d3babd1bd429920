"""The food tables: a search with figures, the page of one food, and its changes as readable lines."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.dashboard.page import CurrentPage, Page, csv_file
from app.foods.api import FoodKey, render_food
from app.foods.edits.api import render_changes
from app.foods.edits.edit_food import list_changes
from app.foods.edits.schemas import ChangeOut
from app.foods.foods import FoodView, read_food
from app.foods.models import Component as ComponentRow
from app.foods.queries import NutrientRow
from app.foods.schemas import FoodMatch, NutrientOut
from app.foods.search.search_foods import ListedFood, food_groups, list_foods
from app.nutrition.components import (
    COMPONENT_BY_NUMBER,
    COMPONENTS,
    HEADLINES,
    Component,
    by_component_group,
)
from app.people.access.page_rules import PREFIX
from app.people.studies import list_studies
from app.records.food_uses import COUNTED, read_uses

NOT_KNOWN = "not known"
NONE = "none"
router = APIRouter(include_in_schema=False)

FOODS = f"{PREFIX}/foods"
LENGTHS = (50, 200, 1000)  # of the list; the last is the search's limit

Output = Annotated[str, Query(alias="format", max_length=8)]


@dataclass(frozen=True, slots=True)
class Difference:
    """A changed field of a food. unit: of figures, else empty."""

    label: str
    old: str
    new: str
    unit: str = ""


def describe_differences(
    differences: Mapping[str, Sequence[object]], rows: Iterable[NutrientRow] = ()
) -> list[Difference]:
    """Describe field -> (old, new), nutrient figures last.

    rows: name components that components.csv lacks.
    """
    components: dict[str, Component | ComponentRow] = {
        row.component.number: row.component for row in rows
    }
    components |= COMPONENT_BY_NUMBER
    changed, figures = [], []
    for name, (old, new) in differences.items():
        number = name.removeprefix("nutrients.")
        if number != name:
            component = components.get(number)
            label, unit = (
                (component.name, str(component.unit)) if component is not None else (number, "")
            )
            figures.append(Difference(label, _figure(old), _figure(new), unit))
        else:
            changed.append(
                Difference(
                    name.replace("_", " ").capitalize(), _describe(name, old), _describe(name, new)
                )
            )
    return changed + figures


def _figure(value: object) -> str:
    return NOT_KNOWN if value is None else repr(value)


def _describe(field: str, value: Any) -> str:
    if value is None or value in ("", [], {}):
        return NONE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return "; ".join(_part(field, part) for part in value)
    if field == "recipe":
        parts = "; ".join(_part("ingredients", part) for part in value["ingredients"])
        return f"yield {value['yield']}: {parts}"
    if isinstance(value, dict):
        return "; ".join(f"{name} {part}" for name, part in value.items())
    return str(value)


def _part(field: str, part: Any) -> str:
    if field == "densities":
        return (
            f"{part['g_per_ml']} ± {part['sd_g_per_ml']} g/ml, {part['kind']}, {part['state']} "
            f"({part['basis']}: {part['source']})"
        )
    if field == "refuse":
        return f"{part['part']} {part['percent']} %{'' if part['is_served'] else ', removed before serving'}"
    if field == "portions":
        return f"{part['amount']} {part['measure']} = {part['mass_g']} g"
    if field == "ingredients":
        retained = ", ".join(f"{number} {share}" for number, share in part["retention"].items())
        return f"{part['mass_g']} g {part['food_key']}" + (
            f" (keeps {retained})" if retained else ""
        )
    return str(part)


class FoodRow(FoodMatch):
    """A row of the list as a file: figures per 100 g edible portion, and the chosen density."""

    energy_kcal_per_100_g: float | None
    density_g_per_ml: float | None
    density_sd_g_per_ml: float | None
    density_kind: str | None
    density_basis: str | None
    density_source: str | None


@dataclass(frozen=True, slots=True)
class ComponentGroup:
    """A group of a food's components: those with a figure, and the names of those without."""

    known: Sequence[NutrientRow]
    unknown: Sequence[str]


def food_address(key: str, *parts: str) -> str:
    """Return the address of a food's page, or of a page below it."""
    return "/".join([FOODS, *[quote(part, safe="") for part in (key, *parts)]])


@router.get(FOODS)
def get_foods(
    page: CurrentPage,
    q: Annotated[str, Query(max_length=100)] = "",
    group: Annotated[str, Query(max_length=100)] = "",
    limit: Annotated[int, Query(ge=1, le=LENGTHS[-1])] = LENGTHS[0],
    output: Output = "",
) -> Response:
    """Foods, best match first; without search words in the tables' order."""
    database, words = page.database, q.strip()
    limit = LENGTHS[-1] if output == "csv" else limit
    rows = list_foods(database, words or None, group=group or None, limit=limit)
    if output == "csv":
        return csv_file(FoodRow, [_row(row) for row in rows], "foods")
    longer = (
        next((length for length in LENGTHS if length > limit), None) if len(rows) == limit else None
    )
    answer = page.render(
        "foods_found.html" if page.is_fragment else "foods.html",
        rows=rows,
        q=words,
        group=group,
        longer=longer,
        food_url=food_address,
        groups=() if page.is_fragment else food_groups(database),
    )
    if page.is_fragment:
        answer.headers["HX-Replace-Url"] = page.address(q=words, group=group, limit=None)
    return answer


@router.get(f"{FOODS}/{{key}}")
def get_food(page: CurrentPage, key: FoodKey, output: Output = "") -> Response:
    """The page of a food, or its nutrients as CSV."""
    if output == "csv":
        food = render_food(read_food(page.database, key))
        return csv_file(NutrientOut, food.nutrients, f"nutrients-of-{food.key}")
    return food_page(page, key)


def food_page(
    page: Page, key: str, *, refused: str | None = None, reason: str = "", status: int = 200
) -> Response:
    """Render the page of a food.

    refused: why restoring a version failed; reason: as entered there.
    """
    database = page.database
    view = read_food(database, key)
    changes = render_changes(list_changes(database, view.value.key)).items
    return page.render(
        "food.html",
        status=status,
        view=view,
        food=view.value,
        groups=component_table(view.nutrients),
        headlines=_headlines(view.nutrients),
        corrected=_corrected(changes),
        origin=changes[-1].previous_release if changes else view.release,
        component_names={component.number: component.name for component in COMPONENTS},
        changes=[
            (change, describe_differences(change.differences, view.nutrients)) for change in changes
        ],
        uses=read_uses(database, page.caller, view.value.key),
        counted=COUNTED,
        food_url=food_address,
        studies=list_studies(database, page.caller, cursor=None, limit=100).rows,
        restorable=_restorable(view, changes),
        refused=refused,
        reason=reason,
    )


def component_table(rows: Sequence[NutrientRow]) -> Mapping[str, ComponentGroup]:
    """Return group -> components with a figure, in reading order, and the names of the others."""
    with_figures = {row.component.number for row in rows}
    listed: list[tuple[str, str, NutrientRow | str]] = [
        (row.component.number, row.component.name, row) for row in rows
    ]
    listed += [
        (part.number, part.name, part.name)
        for part in COMPONENTS
        if part.number not in with_figures
    ]
    return {
        group: ComponentGroup(
            known=[member for member in members if not isinstance(member, str)],
            unknown=[member for member in members if isinstance(member, str)],
        )
        for group, members in by_component_group(listed).items()
    }


def _headlines(rows: Sequence[NutrientRow]) -> list[tuple[str, NutrientRow | None]]:
    """Return the first four headline components as (label, row), by a record's order of preference."""
    by_number = {row.component.number: row for row in rows}
    return [(headline.label, headline.best_of(by_number)) for headline in HEADLINES[:4]]


def _corrected(changes: Sequence[ChangeOut]) -> dict[str, int]:
    """Return component -> the version that last set its figure, for figures that were corrected here."""
    versions: dict[str, int] = {}
    for change in changes:
        for name in change.differences:
            if name.startswith("nutrients."):
                versions.setdefault(name.removeprefix("nutrients."), change.version)
    return versions


def _restorable(view: FoodView, changes: Sequence[ChangeOut]) -> frozenset[int]:
    """Return the versions that can be restored."""
    versions = {change.version for change in changes} | {
        change.previous_version for change in changes
    }
    return frozenset(
        version for version in versions if version is not None and version != view.food.version
    )


def _row(row: ListedFood) -> FoodRow:
    figures = ("g_per_ml", "sd_g_per_ml", "kind", "basis", "source")
    return FoodRow.model_validate(
        row.food.model_dump()
        | {"energy_kcal_per_100_g": row.energy_kcal}
        | {f"density_{name}": getattr(row.density, name, None) for name in figures}
    )
