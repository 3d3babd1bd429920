"""Forms that create and correct foods, for admins: a change is previewed, needs a reason, and makes a new version."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

from fastapi import APIRouter
from pydantic import BaseModel, ValidationError
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, PreconditionFailedError
from app.dashboard.food_pages.food_texts import (
    ADDED_ROWS,
    NUTRIENT,
    body_of,
    changed_fields,
    ingredient_rows,
    texts_of,
)
from app.dashboard.food_pages.foods import (
    FOODS,
    Difference,
    component_table,
    describe_differences,
    food_address,
    food_page,
)
from app.dashboard.food_pages.study_densities import density_values
from app.dashboard.forms import (
    EMPTY_FORM,
    Fields,
    FormState,
    WrongFormError,
    form_values,
    read_form,
    refused,
    sentence,
)
from app.dashboard.page import CurrentPage, Page
from app.foods.api import FoodKey
from app.foods.edits import edit_food
from app.foods.edits.api import food_edit, measured_density, new_food_edit, render_changes
from app.foods.edits.edit_food import Editor, FoodVersion
from app.foods.edits.schemas import ChangeOut, FoodIn, FoodPatch, MeasuredDensityIn, RestoreIn
from app.foods.foods import read_food
from app.foods.search.search_foods import food_groups
from app.nutrition.components import COMPONENT_BY_NUMBER, COMPONENTS, HEADLINES, Component
from app.nutrition.foods import FOOD_FORMS, FOOD_STATES, SLICE_FORMS
from app.people.access.page_rules import PREFIX

Body = TypeVar("Body", bound=BaseModel)
DatedDifferences = tuple[ChangeOut, list[Difference]]

router = APIRouter(include_in_schema=False)

NEW_FOOD = f"{PREFIX}/new-food"
EMPTY_INGREDIENTS = 4
STAY = "Records keep the figures that they were computed from until they are recomputed."
PREVIEW_REASON = "a preview"


@router.get(f"{FOODS}/{{key}}/edit")
def get_edit(page: CurrentPage, key: FoodKey) -> Response:
    """The fields of the food's current version."""
    version = edit_food.read_version(page.database, key)
    return _edit_page(page, version, FormState(texts_of(version)))


@router.post(f"{FOODS}/{{key}}/edit")
def post_edit(page: CurrentPage, key: FoodKey, fields: Fields) -> Response:
    """Preview the changes, or save them."""
    database, entered = page.database, form_values(fields)
    base = edit_food.read_version(database, key, _number(entered.get("base", "")))
    changed = changed_fields(entered, texts_of(base))
    form = FormState(texts_of(base) | entered)
    if entered.get("do") == "rows":
        return _edit_page(page, base, form, more=EMPTY_INGREDIENTS)
    is_preview = entered.get("do") != "save"
    values, wrong = body_of(
        entered, changed, {row.component.number: row.component.unit for row in base.nutrients}
    )
    values["reason"] = PREVIEW_REASON if is_preview else entered.get("reason", "")
    expected = frozenset({base.food.id})
    try:
        body = _read_food(FoodPatch, values, wrong)
        edit = food_edit(body)
        if is_preview:
            differences = edit_food.preview_edit(database, key, edit, expected=expected)
            preview = describe_differences(differences, base.nutrients)
            return _edit_page(page, base, form, preview=preview)
        view = edit_food.edit_food(
            database, key, edit, Editor.of(page.caller, body.reason), expected=expected
        )
    except PreconditionFailedError as error:
        current = edit_food.read_version(database, key)
        kept = {name: entered[name] for name in changed} | {"reason": entered.get("reason", "")}
        added = {
            name: text
            for name, text in entered.items()
            if name.partition("-")[0] in ("add", "figure", "unit")
        }
        form = FormState(texts_of(current) | added | kept, status=error.status)
        return _edit_page(page, current, form, since=_since(page, base))
    except (InvalidInputError, ConflictError) as error:
        return _edit_page(page, base, refused(error, form.values))
    if view.food.id == base.food.id:
        return page.redirect(food_address(view.value.key), "Nothing differs: no version was made.")
    return page.redirect(
        food_address(view.value.key), f"Version {view.food.version} is in force. {STAY}"
    )


@router.post(f"{FOODS}/{{key}}/restore")
def post_restore(page: CurrentPage, key: FoodKey, fields: Fields) -> Response:
    """Restore an earlier version as a new version."""
    entered = form_values(fields)
    reason = entered.get("reason", "")
    try:
        body = read_form(
            RestoreIn, {"version": _number(entered.get("version", "")) or 0, "reason": reason}
        )
        view = edit_food.restore_food(
            page.database,
            key,
            body.version,
            Editor.of(page.caller, body.reason),
            expected=_base(entered),
        )
    except WrongFormError as error:
        refused = "; ".join(f"{name}: {text}" for name, text in error.wrong.items())
        return food_page(page, key, refused=refused, reason=reason, status=error.status)
    except (PreconditionFailedError, ConflictError) as error:
        return food_page(page, key, refused=error.message, reason=reason, status=error.status)
    return page.redirect(
        food_address(view.value.key),
        f"Version {view.food.version} equals version {body.version}. {STAY}",
    )


@router.get(f"{FOODS}/{{key}}/densities")
def get_density(page: CurrentPage, key: FoodKey) -> Response:
    """The form for a measured density."""
    return _density_page(page, key)


@router.post(f"{FOODS}/{{key}}/densities")
def post_density(page: CurrentPage, key: FoodKey, fields: Fields) -> Response:
    """Add a measured density with priority over the food's other measured densities."""
    entered = form_values(fields)
    try:
        body = read_form(MeasuredDensityIn, *density_values(entered))
        density, _ = measured_density(body)
        view = edit_food.add_density(
            page.database,
            key,
            density,
            Editor.of(page.caller, body.reason),
            expected=_base(entered),
        )
    except (InvalidInputError, ConflictError, PreconditionFailedError) as error:
        return _density_page(page, key, refused(error, entered))
    return page.redirect(
        food_address(view.value.key), f"The density was added: version {view.food.version}. {STAY}"
    )


@router.get(NEW_FOOD)
def get_new_food(page: CurrentPage) -> Response:
    """The form for a food, or a dish with its recipe."""
    return _new_page(page)


@router.post(NEW_FOOD)
def post_new_food(page: CurrentPage, fields: Fields) -> Response:
    """Create a food."""
    entered = form_values(fields)
    if entered.get("do") == "rows":
        return _new_page(page, FormState(entered), EMPTY_INGREDIENTS)
    changed = frozenset(name for name, text in entered.items() if text) - {"key", "reason", "do"}
    headlines = {headline.numbers[0] for headline in HEADLINES}
    offered = frozenset(
        name for name in changed if name.removeprefix(NUTRIENT) in headlines or NUTRIENT not in name
    )
    values, wrong = body_of(entered, offered, {})
    values |= {"key": entered.get("key", ""), "reason": entered.get("reason", "")}
    try:
        body = _read_food(FoodIn, values, wrong)
        view = edit_food.create_food(
            page.database, body.key, new_food_edit(body), Editor.of(page.caller, body.reason)
        )
    except (InvalidInputError, ConflictError) as error:
        name = "key" if error.code == "food_exists" else ""
        return _new_page(page, refused(error, entered, name))
    return page.redirect(food_address(view.value.key), f"{view.value.name} was created.")


def _edit_page(
    page: Page,
    version: FoodVersion,
    form: FormState,
    *,
    preview: Sequence[Difference] | None = None,
    since: Sequence[DatedDifferences] = (),
    more: int = 0,
) -> Response:
    with_figures = {row.component.number for row in version.nutrients}
    addable = [part for part in COMPONENTS if part.number not in with_figures]
    return page.render(
        "food_edit.html",
        form=form,
        status=200,
        food=version.value,
        of=version.food,
        has_recipe=version.recipe is not None,
        groups=component_table(version.nutrients),
        preview=preview,
        since=since,
        stay=STAY,
        **_choices(page, form, more, addable),
    )


def _new_page(page: Page, form: FormState = EMPTY_FORM, more: int = 0) -> Response:
    headlines = [COMPONENT_BY_NUMBER[headline.numbers[0]] for headline in HEADLINES]
    others = [component for component in COMPONENTS if component not in headlines]
    return page.render(
        "food_new.html",
        form=form,
        status=200,
        headlines=headlines,
        **_choices(page, form, more, others),
    )


def _choices(
    page: Page, form: FormState, more: int, addable: Sequence[Component]
) -> dict[str, object]:
    return {
        "texts": form.values,
        "rows": ingredient_rows(form.values) + (more or EMPTY_INGREDIENTS // 2),
        "added": ADDED_ROWS,
        "addable": addable,
        "existing_groups": [group.name for group in food_groups(page.database)],
        "forms": FOOD_FORMS,
        "states": FOOD_STATES,
        "slice_forms": SLICE_FORMS,
        "food_url": food_address,
        "code_choices": _code_choices,
    }


def _code_choices(codes: Sequence[str]) -> list[tuple[str, str]]:
    """Return (code, label) for a list of choices."""
    return [(code, code.replace("_", " ")) for code in codes]


def _density_page(page: Page, key: str, form: FormState = EMPTY_FORM) -> Response:
    view = read_food(page.database, key)
    return page.render(
        "food_density.html",
        form=form,
        view=view,
        food_url=food_address,
        stay=STAY,
    )


def _since(page: Page, base: FoodVersion) -> list[DatedDifferences]:
    """Return what others changed since that version."""
    changes = edit_food.list_changes(page.database, base.value.key)
    later = [change for change in changes if change.food.id > base.food.id]
    return [
        (change, describe_differences(change.differences)) for change in render_changes(later).items
    ]


def _read_food(model: type[Body], values: Mapping[str, object], wrong: dict[str, str]) -> Body:
    """As read_form; but an empty field is a value, and errors are named by the form's fields."""
    try:
        body = model.model_validate(values)
    except ValidationError as error:
        first: dict[str, str] = {}
        for detail in error.errors():
            text = _place_in(detail["loc"]) + sentence(detail["type"], detail["msg"])
            first.setdefault(_field_of(detail["loc"]), text)
        raise WrongFormError(first | wrong) from None
    if wrong:
        raise WrongFormError(wrong)
    return body


def _field_of(loc: Sequence[int | str]) -> str:
    """Return the form's field for a place in the body."""
    if loc and loc[0] == "nutrients" and len(loc) > 1:
        return f"{NUTRIENT}{loc[1]}"
    return str(loc[0]) if loc else ""


def _place_in(loc: Sequence[int | str]) -> str:
    """Return the line or part of a field as a prefix, such as "2, g per ml: "; empty for the field itself."""
    if loc and loc[0] == "nutrients":
        return ""
    inner = [str(part + 1) if isinstance(part, int) else part.replace("_", " ") for part in loc[1:]]
    return f"{', '.join(inner)}: " if inner else ""


def _base(entered: Mapping[str, str]) -> frozenset[int]:
    """Return the version with which the form was opened."""
    return frozenset({_number(entered.get("base", "")) or 0})


def _number(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 19 else None
