"""The food tables: a search with figures, and one food with all that is known of it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.dashboard.data_pages.flat_file import csv_file
from app.dashboard.food_pages.food_history import differences_in_words
from app.dashboard.page import CurrentPage, Page
from app.foods.api import FoodKey, render_food
from app.foods.edits.api import render_changes
from app.foods.edits.edit_food import list_changes
from app.foods.edits.schemas import ChangeOut
from app.foods.foods import FoodView, read_food
from app.foods.queries import NutrientRow
from app.foods.schemas import FoodMatch, NutrientOut
from app.foods.search.list_foods import ListedFood, list_foods
from app.foods.search.search_foods import food_groups
from app.nutrition.components import COMPONENTS, HEADLINE_NUMBERS, by_component_group
from app.people.access.page_rules import PREFIX
from app.records.food_uses import COUNTED, read_uses

router = APIRouter(include_in_schema=False)

FOODS = f"{PREFIX}/foods"
LENGTHS = (50, 200, 1000)  # of the list; the last is the most that the search gives

Output = Annotated[str, Query(alias="format", max_length=8)]


class FoodRow(FoodMatch):
    """A food of the list as a row of its file. Figures: of 100 g edible portion; the density that is chosen."""

    energy_kcal_per_100_g: float | None
    density_g_per_ml: float | None
    density_sd_g_per_ml: float | None
    density_kind: str | None
    density_basis: str | None
    density_source: str | None


@dataclass(frozen=True, slots=True)
class ComponentGroup:
    """One group of a food's components: those with a figure, and the names of those without."""

    known: Sequence[NutrientRow]
    unknown: Sequence[str]


def food_address(key: str, *parts: str) -> str:
    """The page of a food, and those below it."""
    return "/".join([FOODS, *[quote(part, safe="") for part in (key, *parts)]])


@router.get(FOODS)
def get_foods(
    page: CurrentPage,
    q: Annotated[str, Query(max_length=100)] = "",
    group: Annotated[str, Query(max_length=100)] = "",
    limit: Annotated[int, Query(ge=1, le=LENGTHS[-1])] = LENGTHS[0],
    output: Output = "",
) -> Response:
    """Foods, best match first; without words in the tables' order."""
    database, words = page.state.database, q.strip()
    limit = LENGTHS[-1] if output == "csv" else limit
    rows = list_foods(database, words or None, group=group or None, limit=limit)
    if output == "csv":
        return csv_file(FoodRow, [_row(row) for row in rows], "foods")
    longer = next((length for length in LENGTHS if length > limit), None) if len(rows) == limit else None
    found: dict[str, Any] = {"rows": rows, "q": words, "group": group, "longer": longer, "food_url": food_address}
    if page.is_fragment:
        answer = page.render("foods_found.html", **found)
        answer.headers["HX-Replace-Url"] = page.address(q=words, group=group, limit=None)
        return answer
    return page.render("foods.html", **found, groups=food_groups(database))


@router.get(f"{FOODS}/{{key}}")
def get_food(page: CurrentPage, key: FoodKey, output: Output = "") -> Response:
    """One food."""
    if output == "csv":
        told = render_food(read_food(page.state.database, key))
        return csv_file(NutrientOut, told.nutrients, f"nutrients-of-{told.key}")
    return food_page(page, key)


def food_page(page: Page, key: str, *, status: int = 200, **context: Any) -> Response:
    """The page of a food. context: what a form below it needs to show again."""
    database = page.state.database
    view = read_food(database, key)
    changes = render_changes(list_changes(database, view.value.key)).items
    context = {"refused": None, "reason": ""} | context
    return page.render(
        "food.html",
        status=status,
        view=view,
        food=view.value,
        groups=component_table(view.nutrients),
        headlines=_headlines(view.nutrients),
        corrected=_corrected(changes),
        origin=changes[-1].previous_release if changes else view.release,
        component_names={one.number: one.name for one in COMPONENTS},
        changes=[(change, differences_in_words(change.differences, view.nutrients)) for change in changes],
        uses=read_uses(database, page.caller, view.value.key),
        counted=COUNTED,
        food_url=food_address,
        restorable=_restorable(view, changes),
        **context,
    )


def component_table(rows: Sequence[NutrientRow]) -> Mapping[str, ComponentGroup]:
    """Group -> its components: those known of a food, in a reader's order, and the names of the rest."""
    known = {row.component.number for row in rows}
    listed: list[tuple[str, str, NutrientRow | str]] = [(row.component.number, row.component.name, row) for row in rows]
    listed += [(one.number, one.name, one.name) for one in COMPONENTS if one.number not in known]
    return {
        group: ComponentGroup(
            known=[member for member in members if not isinstance(member, str)],
            unknown=[member for member in members if isinstance(member, str)],
        )
        for group, members in by_component_group(listed).items()
    }


def _headlines(rows: Sequence[NutrientRow]) -> list[tuple[str, NutrientRow | None]]:
    """The first four of the components that a record has, as it takes them."""
    known = {row.component.number: row for row in rows}
    labels = ("Energy", "Protein", "Fat", "Carbohydrate")
    return [
        (label, next((known[number] for number in numbers if number in known), None))
        for label, numbers in zip(labels, HEADLINE_NUMBERS, strict=False)
    ]


def _corrected(changes: Sequence[ChangeOut]) -> dict[str, int]:
    """Component -> the version that last gave it its figure, of those that were corrected here."""
    found: dict[str, int] = {}
    for change in changes:
        for name in change.differences:
            if name.startswith("nutrients."):
                found.setdefault(name.removeprefix("nutrients."), change.version)
    return found


def _restorable(view: FoodView, changes: Sequence[ChangeOut]) -> frozenset[int]:
    """The versions that the food can be put back to."""
    told = {change.version for change in changes} | {change.previous_version for change in changes}
    return frozenset(version for version in told if version is not None and version != view.food.version)


def _row(row: ListedFood) -> FoodRow:
    figures = ("g_per_ml", "sd_g_per_ml", "kind", "basis", "source")
    return FoodRow.model_validate(
        asdict(row.food)
        | {"energy_kcal_per_100_g": row.energy_kcal}
        | {f"density_{name}": getattr(row.density, name, None) for name in figures}
    )
