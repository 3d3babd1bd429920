"""Make and correct foods. Nothing is overwritten: a correction is a new version of the food in the release "local".

That release goes before all imported ones, so that a correction survives the next release of the table that it
corrects. Each version keeps its author, time and reason, and what differs from the version before.
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Self, TypeVar

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError, PreconditionFailedError
from app.db.session import Database
from app.foods import queries as foods
from app.foods.component_names import Figure, add_missing_components, contents_of, numbers_called
from app.foods.edits import queries as food_changes
from app.foods.edits.queries import Change
from app.foods.food_values import own_value
from app.foods.foods import FoodView, require_food, view_of
from app.foods.import_foods import write_food
from app.foods.models import Food, FoodActivation, FoodChange, FoodRelease
from app.foods.queries import NutrientRow
from app.foods.recipes import NamedRecipe, PinnedRecipe, cook, pinned_recipe, write_recipe
from app.nutrition.foods import Density
from app.nutrition.foods import Food as FoodValue
from app.nutrition.plausible import why_impossible
from app.people.access.audit import note
from app.people.access.caller import StaffCaller

T = TypeVar("T")
Differences = dict[str, list[object]]  # field -> [old, new] as JSON; a component's field is `nutrients.NUMBER`

LOCAL_CHECKSUM = "local"  # the release of corrections is read from nothing, and there is one
LOCAL_VERSION = "1"
ATTEMPTS = 5  # an edit that does not say what it edits is made again on top of one that came in between


@dataclass(frozen=True, slots=True)
class Editor:
    """Who changes something, and why. caller: for the audit log; None: by the command line."""

    author: str
    reason: str
    caller: StaffCaller | None = None

    @classmethod
    def of(cls, caller: StaffCaller, reason: str) -> Self:
        """Return the editor that a member of staff is."""
        return cls(author_of(caller), reason, caller)


@dataclass(frozen=True, slots=True)
class FoodEdit:
    """What to change. fields: of nutrition.foods.Food, by name, with their new values.

    nutrients: number or INFOODS tagname -> new figure; None takes the figure away: not known, which is not 0.
    recipe: the dish is made so, and its figures follow from it. without_recipe: its figures stay, the recipe goes.
    """

    fields: Mapping[str, Any] = field(default_factory=dict)
    nutrients: Mapping[str, Figure | None] = field(default_factory=dict)
    recipe: NamedRecipe | None = None
    without_recipe: bool = False


@dataclass(frozen=True, slots=True)
class FoodVersion:
    """A version of a food as a correction of it starts: its own densities alone.

    recipe: of a dish that has one. states: of its ingredients, by Food.id. nutrients: value.per_100_g, told in full.
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
    """Return a member of staff as the history names them."""
    return f"staff: {caller.name}"[:200]


def create_food(database: Database, key: str, edit: FoodEdit, editor: Editor) -> FoodView:
    """A new food, as version 1. Raises ConflictError `food_exists`, and what edit_food raises."""
    taken = ConflictError(f"There is already a food {key!r}: correct it instead.", code="food_exists", food=key)
    blank = _checked(lambda: FoodValue(key=key, **edit.fields))

    def make(session: Session, release: FoodRelease) -> FoodView:
        if foods.foods_by_key(session, [key]):
            raise taken
        draft = _edited(session, _Draft(blank, None), replace(edit, fields={}))
        return view_of(session, _write(session, release, draft, 1, None, {}, editor), None)

    return _written(database, editor, make, taken)


def edit_food(
    database: Database, key: str, edit: FoodEdit, editor: Editor, *, expected: Collection[int] | None = None
) -> FoodView:
    """A new version of a food with these changes; the food as it is where nothing would differ.

    expected: the versions (Food.id) that the editor may mean; None: whatever is in force.
    Raises NotFoundError; PreconditionFailedError if another version is in force by now; InvalidInputError if a
    component is unknown, a unit or a figure cannot be, or the recipe cannot.
    """
    return _new_version(database, key, lambda session, _, draft: _edited(session, draft, edit), editor, expected)


def preview_edit(
    database: Database, key: str, edit: FoodEdit, *, expected: Collection[int] | None = None
) -> Differences:
    """What edit_food would change: field -> [old, new], as the history has it. Writes nothing; raises the same."""
    with database.read() as session:
        current = require_food(session, key)
        _require_expected(current, expected)
        _refuse_densities_only(session, current)
        before = _Draft(own_value(session, current), pinned_recipe(session, current))
        return _differences(before, _edited(session, before, edit))


def read_version(database: Database, key: str, food_id: int | None = None) -> FoodVersion:
    """A version of the food of this key, in force or not; None: the one in force. Raises NotFoundError."""
    with database.read() as session:
        current = require_food(session, key)
        food = current if food_id is None else session.get(Food, food_id)
        if food is None or food.key != current.key:
            raise NotFoundError(f"{current.key!r} has no such version.", code="food_version_not_found")
        recipe = pinned_recipe(session, food)
        parts = foods.foods_by_id(session, [part.food_id for part in recipe.ingredients] if recipe else [])
        return FoodVersion(
            food=food,
            value=own_value(session, food),
            recipe=recipe,
            states={part.id: part.state for part in parts},
            nutrients=foods.nutrients_of(session, food.id),
        )


def add_density(
    database: Database, key: str, density: Density, editor: Editor, *, expected: Collection[int] | None = None
) -> FoodView:
    """A new version of a food with this density before its others of the same worth. Raises what edit_food raises."""

    def put_first(_: Session, __: Food, draft: _Draft) -> _Draft:
        return replace(draft, value=replace(draft.value, densities=(density, *draft.value.densities)))

    return _new_version(database, key, put_first, editor, expected)


def restore_food(
    database: Database, key: str, version: int, editor: Editor, *, expected: Collection[int] | None = None
) -> FoodView:
    """A new version of a food that equals an earlier one, including the version before any correction.

    Raises NotFoundError `food_version_not_found`, and what edit_food raises.
    """

    def as_it_was(session: Session, current: Food, _: _Draft) -> _Draft:
        changes = food_changes.changes_of(session, current.key)
        versions = {change.previous.version: change.previous for change in changes if change.previous is not None}
        versions |= {change.food.version: change.food for change in changes}
        if version not in versions:
            raise NotFoundError(f"{current.key!r} has no version {version}.", code="food_version_not_found")
        return _Draft(own_value(session, versions[version]), pinned_recipe(session, versions[version]))

    return _new_version(database, key, as_it_was, editor, expected)


def list_changes(database: Database, key: str) -> Sequence[Change]:
    """Who changed a food, when and why, the newest change first. Raises NotFoundError."""
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
            current = _write(session, release, after, current.version + 1, current, differences, editor)
        return view_of(session, current, None)

    busy = ConflictError(f"{key!r} is being changed by others all the time: try again.", code="food_busy")
    return _written(database, editor, correct, busy)


def _written(
    database: Database, editor: Editor, write: Callable[[Session, FoodRelease], FoodView], busy: ConflictError
) -> FoodView:
    """What `write` writes into the release of corrections, tried again where another version came in between."""
    _require_local_release(database, editor.author)
    for _ in range(ATTEMPTS):
        try:
            with database.write() as session:
                return write(session, _local_in_force(session))
        except IntegrityError:
            continue  # the next turn sees the other version
    raise busy


def _require_expected(current: Food, expected: Collection[int] | None) -> None:
    if expected is not None and current.id not in expected:
        raise PreconditionFailedError(
            f"{current.key!r} has been changed since: version {current.version} is in force. Read it anew.",
            code="food_changed_since",
            version=current.version,
        )


def _edited(session: Session, draft: _Draft, edit: FoodEdit) -> _Draft:
    value = _checked(lambda: replace(draft.value, **edit.fields))
    recipe = None if edit.without_recipe else draft.recipe
    if edit.nutrients and (edit.recipe or recipe) is not None:
        raise InvalidInputError(
            "The figures of a dish with a recipe follow from it: change the recipe, or take it away to give figures.",
            code="nutrients_of_recipe",
        )
    per_100_g = dict(draft.value.per_100_g)
    named_recipe = edit.recipe
    if named_recipe is not None:
        recipe, dish = _checked(lambda: cook(session, value.key, named_recipe))
        per_100_g = dict(dish.per_100_g)
    named = numbers_called(session, edit.nutrients)
    per_100_g |= contents_of(session, {number: figure for number, figure in named.items() if figure is not None})
    per_100_g = {number: content for number, content in per_100_g.items() if named.get(number, content) is not None}
    if per_100_g != draft.value.per_100_g:
        why = why_impossible(per_100_g)
        if why is not None and why_impossible(draft.value.per_100_g) is None:  # else it came so, and gets no worse
            raise InvalidInputError(why, code="figures_impossible")
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
    note(session, editor.caller, "food.change", subject=row.key, version=version, fields=sorted(differences))
    session.flush()
    return row


def _differences(before: _Draft, after: _Draft) -> Differences:
    old, new = _as_json(before), _as_json(after)
    return {name: [old.get(name), new.get(name)] for name in (old | new) if old.get(name) != new.get(name)}


def _as_json(draft: _Draft) -> dict[str, object]:
    """Fields by the names that the API has for them; the figures one by one."""
    value = asdict(replace(draft.value, source_ids=dict(draft.value.source_ids), per_100_g={}))
    fields = {"group" if name == "food_group" else name: part for name, part in value.items()}
    fields |= {f"nutrients.{number}": content for number, content in draft.value.per_100_g.items()}
    if draft.recipe is not None:
        recipe = asdict(draft.recipe)
        fields["recipe"] = {"yield": recipe["recipe_yield"], "ingredients": recipe["ingredients"]}
    plain: dict[str, object] = json.loads(json.dumps(fields))  # lists for tuples, as the history keeps them
    return plain


def _checked(make: Callable[[], T]) -> T:
    """What `make` gives; a ValueError of a value that cannot be is the caller's."""
    try:
        return make()
    except ValueError as error:
        raise InvalidInputError(f"The food cannot be: {error}.", code="food_invalid") from None


def _refuse_densities_only(session: Session, food: Food) -> None:
    if session.get_one(FoodRelease, food.release_id).source == foods.DENSITIES_ONLY:
        raise InvalidInputError(
            f"{food.key!r} is a row of a table of densities: correct the density of the food that it weighs.",
            code="food_has_densities_only",
        )


def _local_in_force(session: Session) -> FoodRelease:
    release = food_changes.local_release(session)
    if release is None or release.id not in {one.id for one in foods.releases_in_force(session)}:
        raise ConflictError(
            "Corrections are out of force, so this one would change nothing: `tada foods use local 1` first.",
            code="local_foods_off",
        )
    return release


def _require_local_release(database: Database, author: str) -> None:
    """Make the release of corrections on first use, and put it in force; safe when two callers do so at once."""
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
            session.add(FoodActivation(name=foods.LOCAL, release_id=release.id, author=author, activated_at=now))
    except IntegrityError:
        with database.read() as session:
            if food_changes.local_release(session) is None:
                raise
