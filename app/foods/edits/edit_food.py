"""Create and correct foods.

Nothing is overwritten: a correction is a new version of the food in the release "local".

That release takes precedence over all imported ones, so that a correction survives the next release
of the table that it corrects. Each version keeps its author, time and reason, and its differences
from the previous version.
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from typing import Self, TypedDict, TypeVar

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError, PreconditionFailedError
from app.db.session import Database
from app.foods import queries as foods
from app.foods.component_names import Figure, add_missing_components, component_numbers, contents_of
from app.foods.edits import queries as food_changes
from app.foods.edits.queries import Change
from app.foods.food_values import own_value
from app.foods.foods import FoodView, require_food, view_of
from app.foods.import_foods import write_food
from app.foods.models import Food, FoodActivation, FoodChange, FoodRelease
from app.foods.queries import NutrientRow
from app.foods.recipes import NamedRecipe, PinnedRecipe, cook, pinned_recipe, write_recipe
from app.nutrition.foods import Density, FoodForm, FoodState, RefusePart, SliceForm
from app.nutrition.foods import Food as FoodValue
from app.nutrition.plausible import why_impossible
from app.nutrition.portions import Portion
from app.people.access.audit import note
from app.people.access.caller import StaffCaller

T = TypeVar("T")
# field -> [old, new] as JSON; a component's field is `nutrients.NUMBER`
Differences = dict[str, list[object]]

LOCAL_CHECKSUM = "local"  # the one release of corrections is read from no file
LOCAL_VERSION = "1"
ATTEMPTS = 5  # an edit without expected versions is retried on top of a concurrent one


@dataclass(frozen=True, slots=True)
class Editor:
    """Author and reason of a change. caller: for the audit log; None: the command line."""

    author: str
    reason: str
    caller: StaffCaller | None = None

    @classmethod
    def of(cls, caller: StaffCaller, reason: str) -> Self:
        """Return a member of staff as editor."""
        return cls(author_of(caller), reason, caller)


class FoodFields(TypedDict, total=False):
    """Fields of nutrition.foods.Food that an edit may set."""

    name: str
    food_group: str
    form: FoodForm
    aliases: tuple[str, ...]
    slice_form: SliceForm | None
    state: FoodState | None
    is_mixed_dish: bool
    refuse: tuple[RefusePart, ...]
    densities: tuple[Density, ...]
    portions: tuple[Portion, ...]
    probes: tuple[str, ...]
    source_ids: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class FoodEdit:
    """Changes to a food. fields: the new values.

    nutrients: number or INFOODS tagname -> new figure; None removes the figure: not known, which is
    not 0. recipe: new recipe, from which the figures are computed. without_recipe: remove the
    recipe and keep the figures.
    """

    fields: FoodFields = field(default_factory=FoodFields)
    nutrients: Mapping[str, Figure | None] = field(default_factory=dict)
    recipe: NamedRecipe | None = None
    without_recipe: bool = False


@dataclass(frozen=True, slots=True)
class FoodVersion:
    """A version of a food as the starting point of a correction, with only its own densities.

    recipe: None if it has none. states: of its ingredients, by Food.id. nutrients: value.per_100_g
    with its components.
    """

    food: Food
    value: FoodValue
    recipe: PinnedRecipe | None
    states: Mapping[int, str | None]
    nutrients: Sequence[NutrientRow]


@dataclass(frozen=True, slots=True)
class _Draft:
    value: FoodValue
    recipe: PinnedRecipe | None


def author_of(caller: StaffCaller) -> str:
    """Return the author's name of a member of staff in the history."""
    return f"staff: {caller.name}"[:200]


def create_food(database: Database, key: str, edit: FoodEdit, editor: Editor) -> FoodView:
    """Create a food, as version 1.

    Raises ConflictError `food_exists`, and what edit_food raises.
    """
    exists_error = ConflictError(
        f"There is already a food {key!r}: correct it instead.", code="food_exists", food=key
    )
    blank = _checked(lambda: FoodValue(key=key, **edit.fields))

    def make(session: Session, release: FoodRelease) -> FoodView:
        if foods.foods_by_key(session, [key]):
            raise exists_error
        draft = _apply_edit(session, _Draft(blank, None), replace(edit, fields={}))
        return view_of(session, _write(session, release, draft, 1, None, {}, editor), None)

    return _write_with_retries(database, editor, make, exists_error)


def edit_food(
    database: Database,
    key: str,
    edit: FoodEdit,
    editor: Editor,
    *,
    expected: Collection[int] | None = None,
) -> FoodView:
    """Create a new version of a food with these changes; return the current one if nothing would change.

    expected: the versions (Food.id) that the edit applies to; None: any. Raises NotFoundError;
    PreconditionFailedError if another version is in force; InvalidInputError if a component is
    unknown, or a unit, figure or recipe is invalid.
    """
    return _new_version(
        database, key, lambda session, _, draft: _apply_edit(session, draft, edit), editor, expected
    )


def preview_edit(
    database: Database, key: str, edit: FoodEdit, *, expected: Collection[int] | None = None
) -> Differences:
    """Return what edit_food would change: field -> [old, new], as in the history.

    Writes nothing; raises the same.
    """
    with database.read() as session:
        current = require_food(session, key)
        _require_expected(current, expected)
        _refuse_densities_only(session, current)
        before = _Draft(own_value(session, current), pinned_recipe(session, current))
        return _differences(before, _apply_edit(session, before, edit))


def read_version(database: Database, key: str, food_id: int | None = None) -> FoodVersion:
    """Return a version of the food of this key; food_id None: the version in force.

    Raises NotFoundError.
    """
    with database.read() as session:
        current = require_food(session, key)
        food = current if food_id is None else session.get(Food, food_id)
        if food is None or food.key != current.key:
            raise NotFoundError(
                f"{current.key!r} has no such version.", code="food_version_not_found"
            )
        recipe = pinned_recipe(session, food)
        parts = foods.foods_by_id(
            session, [part.food_id for part in recipe.ingredients] if recipe else []
        )
        return FoodVersion(
            food=food,
            value=own_value(session, food),
            recipe=recipe,
            states={part.id: part.state for part in parts},
            nutrients=foods.nutrients_of(session, food.id),
        )


def add_density(
    database: Database,
    key: str,
    density: Density,
    editor: Editor,
    *,
    expected: Collection[int] | None = None,
) -> FoodView:
    """Create a version of a food with this density before others of the same basis.

    Raises what edit_food raises.
    """

    def put_first(_: Session, __: Food, draft: _Draft) -> _Draft:
        return replace(
            draft, value=replace(draft.value, densities=(density, *draft.value.densities))
        )

    return _new_version(database, key, put_first, editor, expected)


def restore_food(
    database: Database,
    key: str,
    version: int,
    editor: Editor,
    *,
    expected: Collection[int] | None = None,
) -> FoodView:
    """Create a version of a food that equals an earlier one, including the version before any correction.

    Raises NotFoundError `food_version_not_found`, and what edit_food raises.
    """

    def restored(session: Session, current: Food, _: _Draft) -> _Draft:
        changes = food_changes.changes_of(session, current.key)
        versions = {
            change.previous.version: change.previous
            for change in changes
            if change.previous is not None
        }
        versions |= {change.food.version: change.food for change in changes}
        if version not in versions:
            raise NotFoundError(
                f"{current.key!r} has no version {version}.", code="food_version_not_found"
            )
        return _Draft(
            own_value(session, versions[version]), pinned_recipe(session, versions[version])
        )

    return _new_version(database, key, restored, editor, expected)


def list_changes(database: Database, key: str) -> Sequence[Change]:
    """Return the changes of a food, the newest first. Raises NotFoundError."""
    with database.read() as session:
        return food_changes.changes_of(session, require_food(session, key).key)


def _new_version(
    database: Database,
    key: str,
    change: Callable[[Session, Food, _Draft], _Draft],
    editor: Editor,
    expected: Collection[int] | None,
) -> FoodView:

    def correct(session: Session, release: FoodRelease) -> FoodView:
        current = require_food(session, key)
        _require_expected(current, expected)
        _refuse_densities_only(session, current)
        before = _Draft(own_value(session, current), pinned_recipe(session, current))
        after = change(session, current, before)
        differences = _differences(before, after)
        if differences:
            current = _write(
                session, release, after, current.version + 1, current, differences, editor
            )
        return view_of(session, current, None)

    busy = ConflictError(f"Others keep changing {key!r}: try again.", code="food_busy")
    return _write_with_retries(database, editor, correct, busy)


def _write_with_retries(
    database: Database,
    editor: Editor,
    write: Callable[[Session, FoodRelease], FoodView],
    busy: ConflictError,
) -> FoodView:
    """Return the result of `write` in the release of corrections; retry after a concurrent version."""
    _require_local_release(database, editor.author)
    for _ in range(ATTEMPTS):
        try:
            with database.write() as session:
                return write(session, _local_in_force(session))
        except IntegrityError:
            continue  # the next attempt sees the other version
    raise busy


def _require_expected(current: Food, expected: Collection[int] | None) -> None:
    if expected is not None and current.id not in expected:
        raise PreconditionFailedError(
            f"{current.key!r} has been changed since: version {current.version} is in force. Read it again.",
            code="food_changed_since",
            version=current.version,
        )


def _apply_edit(session: Session, draft: _Draft, edit: FoodEdit) -> _Draft:
    value = _checked(lambda: replace(draft.value, **edit.fields))
    recipe = None if edit.without_recipe else draft.recipe
    if edit.nutrients and (edit.recipe or recipe) is not None:
        raise InvalidInputError(
            "The figures of a dish with a recipe follow from it: change the recipe, or remove it to give figures.",
            code="nutrients_of_recipe",
        )
    per_100_g = dict(draft.value.per_100_g)
    named_recipe = edit.recipe
    if named_recipe is not None:
        recipe, dish = _checked(lambda: cook(session, value.key, named_recipe))
        per_100_g = dict(dish.per_100_g)
    figures = component_numbers(session, edit.nutrients)
    per_100_g |= contents_of(
        session, {number: figure for number, figure in figures.items() if figure is not None}
    )
    per_100_g = {
        number: content
        for number, content in per_100_g.items()
        if figures.get(number, content) is not None
    }
    if per_100_g != draft.value.per_100_g:
        problem = why_impossible(per_100_g)
        # otherwise it was impossible before
        if problem is not None and why_impossible(draft.value.per_100_g) is None:
            raise InvalidInputError(problem, code="figures_impossible")
        value = _checked(lambda: replace(value, per_100_g=per_100_g))
    return _Draft(value, recipe)


def _write(
    session: Session,
    release: FoodRelease,
    draft: _Draft,
    version: int,
    previous: Food | None,
    differences: Differences,
    editor: Editor,
) -> Food:
    add_missing_components(session, draft.value.per_100_g)
    row = write_food(session, release, draft.value, version=version)
    if draft.recipe is not None:
        write_recipe(session, row, draft.recipe)
    if previous is not None and previous.release_id == release.id:
        previous.superseded_by_id = row.id
    session.add(
        FoodChange(
            food_id=row.id,
            previous_id=previous.id if previous else None,
            author=editor.author,
            reason=editor.reason,
            differences=differences,
            changed_at=datetime.now(UTC),
        )
    )
    note(
        session,
        editor.caller,
        "food.change",
        subject=row.key,
        version=version,
        fields=sorted(differences),
    )
    session.flush()
    return row


def _differences(before: _Draft, after: _Draft) -> Differences:
    old, new = _as_json(before), _as_json(after)
    return {
        name: [old.get(name), new.get(name)]
        for name in (old | new)
        if old.get(name) != new.get(name)
    }


def _as_json(draft: _Draft) -> dict[str, object]:
    """Return the fields by their names in the API, each nutrient as a field."""
    value = asdict(replace(draft.value, source_ids=dict(draft.value.source_ids), per_100_g={}))
    fields = {"group" if name == "food_group" else name: part for name, part in value.items()}
    fields |= {f"nutrients.{number}": content for number, content in draft.value.per_100_g.items()}
    if draft.recipe is not None:
        recipe = asdict(draft.recipe)
        fields["recipe"] = {"yield": recipe["recipe_yield"], "ingredients": recipe["ingredients"]}
    plain: dict[str, object] = json.loads(json.dumps(fields))  # lists for tuples, as in the history
    return plain


def _checked(make: Callable[[], T]) -> T:
    """Return the result of `make`; raise its ValueError as InvalidInputError."""
    try:
        return make()
    except ValueError as error:
        raise InvalidInputError(f"The food is not valid: {error}.", code="food_invalid") from None


def _refuse_densities_only(session: Session, food: Food) -> None:
    if session.get_one(FoodRelease, food.release_id).source == foods.DENSITIES_ONLY:
        raise InvalidInputError(
            f"{food.key!r} is a row of a table of densities: correct the density of the food itself.",
            code="food_has_densities_only",
        )


def _local_in_force(session: Session) -> FoodRelease:
    release = food_changes.local_release(session)
    if release is None or release.id not in {
        active.id for active in foods.releases_in_force(session)
    }:
        raise ConflictError(
            "Corrections are not in force, so this one would change nothing: run `tada foods use local 1` first.",
            code="local_foods_off",
        )
    return release


def _require_local_release(database: Database, author: str) -> None:
    """Create the release of corrections on first use and put it in force; safe for concurrent callers."""
    with database.read() as session:
        if food_changes.local_release(session) is not None:
            return
    now = datetime.now(UTC)
    release = FoodRelease(
        source=foods.LOCAL,
        name=foods.LOCAL,
        version=LOCAL_VERSION,
        released_on=now.date(),
        checksum=LOCAL_CHECKSUM,
        imported_at=now,
        completed_at=now,
    )
    try:
        with database.write() as session:
            session.add(release)
            session.flush()
            session.add(
                FoodActivation(
                    name=foods.LOCAL, release_id=release.id, author=author, activated_at=now
                )
            )
    except IntegrityError:
        with database.read() as session:
            if food_changes.local_release(session) is None:
                raise
