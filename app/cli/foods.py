"""`tada foods`: search, show, import, releases; create and correct foods. `tada vessels`."""

import json
import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from app.cli.database import JsonOption, author, opened_database, read_json
from app.core.errors import InvalidInputError

if TYPE_CHECKING:
    from pydantic import BaseModel

    from app.foods.foods import FoodView

foods_cli = typer.Typer(no_args_is_help=True, help="The food table.")

Model = TypeVar("Model", bound="BaseModel")
KeyArgument = Annotated[
    str,
    typer.Argument(
        metavar="KEY", help="The food's key, or its number in a published table, such as 09003."
    ),
]
ReasonOption = Annotated[str | None, typer.Option(help="Why, for the history.")]
vessels_cli = typer.Typer(no_args_is_help=True, help="A study's measured mugs and bowls.")

StudyArgument = Annotated[str, typer.Argument(metavar="STUDY", help="The study's code.")]


@foods_cli.command("search")
def foods_search(
    words: list[str],
    group: Annotated[
        str | None, typer.Option(help="Only foods of this group: its exact name, ignoring case.")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many foods at most.")] = 20,
    as_json: JsonOption = False,
) -> None:
    """Find foods by name, alias or code, even mistyped or incomplete; best match first."""
    from app.foods.search.search_foods import search_foods

    with opened_database() as database:
        foods = search_foods(database, " ".join(words), group=group, limit=limit)
    if as_json:
        print(json.dumps([food.model_dump() for food in foods]))
    else:
        print(
            "\n".join(f"{food.key:<32} {food.name}  [{food.release}]" for food in foods)
            or "No food of that name."
        )
    raise SystemExit(0 if foods else 1)


@foods_cli.command("show")
def foods_show(
    key: KeyArgument,
    as_json: JsonOption = False,
) -> None:
    """Show one food of the tables in force, its density and the densities that were rejected."""
    from app.foods.foods import read_food

    with opened_database() as database:
        view = read_food(database, key)
    if as_json:
        from app.foods.api import render_food

        print(render_food(view).model_dump_json())
        return
    value = view.value
    print(f"{value.name} ({value.key}), {view.release}, version {view.food.version}")
    print(f"  {value.food_group}; {value.form}, {value.state or 'state not known'}")
    if view.density is None:
        print("  density  not known: its volumes give no grams")
    else:
        chosen = view.density.chosen
        print(f"  density  {chosen.g_per_ml:.3f} +- {chosen.sd_g_per_ml:.3f} g/ml  {chosen.source}")
        print(f"           {view.density.reason}")
        for rejected in view.density.alternatives:
            density = rejected.density
            print(
                f"    not    {density.g_per_ml:.3f} +- {density.sd_g_per_ml:.3f} g/ml  {density.source}"
            )
            print(f"           {rejected.reason}")
    for part in value.refuse:
        print(f"  refuse   {part.percent:g} %  {part.part}")
    if view.recipe is not None:
        print(f"  recipe   yield {view.recipe.recipe_yield:g}")
        for ingredient in view.recipe.ingredients:
            food = ingredient.food
            print(
                f"    of     {ingredient.mass_g:g} g  {food.name} ({food.key}, version {food.version})"
            )
    for portion in value.portions:
        print(f"  portion  {portion.amount:g} {portion.measure}: {portion.mass_g:g} g")
    for row in view.nutrients:
        print(f"  {row.component.name:<40} {row.per_100_g:g} {row.component.unit} in 100 g edible")


@foods_cli.command("import")
def foods_import(
    source: Annotated[
        str, typer.Argument(metavar="FORMAT", help="sr28, fdc, fao-density, csv or off.")
    ],
    path: Annotated[Path, typer.Argument(help="The release: a zip, a folder or a file.")],
    name: Annotated[str | None, typer.Option(help="csv: the table's name, such as bls.")] = None,
    version: Annotated[str | None, typer.Option(help="csv: the table's version.")] = None,
    released_on: Annotated[
        datetime | None, typer.Option(formats=["%Y-%m-%d"], help="csv: its date of publication.")
    ] = None,
) -> None:
    """Import a published food table: validate it, write it, put it in force.

    Importing it again changes nothing. off: Open Food Facts' dump, packaged foods by barcode.
    """
    from app.foods.food_releases import read_food_release
    from app.foods.import_foods import import_foods

    def report_progress(written: int, total: int) -> None:
        ending = "\n" if written == total else "\r"
        print(f"  {written} of {total} foods written", end=ending, file=sys.stderr, flush=True)

    print(f"reading {path} ...", file=sys.stderr, flush=True)
    if source == "off":
        from app.foods.packaged.import_packaged import import_packaged

        with opened_database() as database:
            imported, report = import_packaged(database, path, author(), report_progress)
    else:
        imported = read_food_release(
            source,
            path,
            name=name,
            version=version,
            released_on=released_on.date() if released_on else None,
        )
        with opened_database() as database:
            report = import_foods(database, imported, author(), report_progress)
    outcome = "was there already: nothing changed" if report.was_there else "imported and in force"
    table = imported.table
    print(
        f"{table.name} {table.version}: {report.foods} foods, {report.values} nutrient values, {outcome}"
    )
    print(f"checksum {table.checksum}")
    for sentence in imported.skipped.sentences():
        print(f"skipped: {sentence}")


@foods_cli.command("releases")
def foods_releases() -> None:
    """List the releases in the database: first those in force, in order of precedence."""
    from app.foods.food_releases import list_releases

    with opened_database() as database:
        releases = list_releases(database)
    for listed in releases:
        release = listed.release
        mark = (
            "in force"
            if listed.is_in_force
            else "complete"
            if release.completed_at
            else "broken off"
        )
        print(
            f"{release.name:<24} {release.version:<12} {release.released_on}  {mark:<10}  {release.checksum[:12]}"
        )


@foods_cli.command("use")
def foods_use(
    name: str,
    version: Annotated[
        str | None, typer.Argument(help="Left out: no release of this name is in force.")
    ] = None,
) -> None:
    """Put another release of a table in force, or none.

    Records do not change: see `tada records recompute`.
    """
    from app.foods.food_releases import use_release

    with opened_database() as database:
        use_release(database, name, version, author=author())
    print(f"{name} {version}: in force" if version else f"{name}: no release is in force")


@foods_cli.command("create")
def foods_create(
    file: Annotated[
        Path, typer.Argument(help="JSON as POST /v1/foods takes it; - for standard input.")
    ],
    reason: ReasonOption = None,
) -> None:
    """Create a food, or a dish with its recipe."""
    from app.foods.edits.api import new_food_edit
    from app.foods.edits.edit_food import Editor, create_food
    from app.foods.edits.schemas import FoodIn

    body = _body(FoodIn, _read_object(file), reason)
    with opened_database() as database:
        view = create_food(database, body.key, new_food_edit(body), Editor(author(), body.reason))
    _print_version(view)


@foods_cli.command("edit")
def foods_edit(
    key: KeyArgument,
    file: Annotated[
        Path | None,
        typer.Argument(help="JSON as PATCH /v1/foods/KEY takes it; - for standard input."),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="FIELD=VALUE",
            help='VALUE is JSON or text; nutrients.VITC={"per_100_g": 9, "unit": "mg"}, or =null: not known.',
        ),
    ] = None,
    reason: ReasonOption = None,
) -> None:
    """Correct a food: create a version with the given changes; the previous one is kept."""
    from app.foods.edits.api import food_edit
    from app.foods.edits.edit_food import Editor, edit_food
    from app.foods.edits.schemas import FoodPatch

    if file is None and not changes:
        raise InvalidInputError("Say what to change: a FILE, or --set FIELD=VALUE.")
    document = _read_object(file) if file is not None else {}
    for change in changes or ():
        _set(document, change)
    body = _body(FoodPatch, document, reason)
    with opened_database() as database:
        view = edit_food(database, key, food_edit(body), Editor(author(), body.reason))
    _print_version(view)


@foods_cli.command("density")
def foods_density(
    key: KeyArgument,
    kind: Annotated[
        str, typer.Option(help="solid: of the piece itself; bulk: with the air in a heap.")
    ],
    state: Annotated[str, typer.Option(help='State when weighed, such as "raw, sliced".')],
    method: Annotated[str, typer.Option(help="How it was measured.")],
    reason: ReasonOption = None,
    g_per_ml: Annotated[float | None, typer.Option(help="The density, with --sd.")] = None,
    sd: Annotated[
        float | None, typer.Option(help="Standard deviation between specimens, g/ml.")
    ] = None,
    specimens: Annotated[
        list[str] | None,
        typer.Option(
            "--specimen", metavar="ML:G", help="Volume and mass of a specimen; give two or more."
        ),
    ] = None,
    volume_step: Annotated[
        float, typer.Option(help="Precision of the specimens' volumes, ml.")
    ] = 1.0,
    weighs: Annotated[str, typer.Option(help="What was weighed: as_seen or edible.")] = "as_seen",
    study: Annotated[
        str | None, typer.Option(help="Only for this study, where it takes precedence.")
    ] = None,
) -> None:
    """Add a measured density to a food, or to one study's own."""
    from app.foods.edits.api import measured_density
    from app.foods.edits.edit_food import Editor, add_density
    from app.foods.edits.schemas import MeasuredDensityIn
    from app.foods.study_densities import Measurement, add_study_density

    document: dict[str, object] = {"kind": kind, "state": state, "method": method, "weighs": weighs}
    document |= {"g_per_ml": g_per_ml, "sd_g_per_ml": sd, "volume_step_ml": volume_step}
    if specimens:
        document["specimens"] = [_specimen(text) for text in specimens]
    body = _body(MeasuredDensityIn, document, reason)
    density, weighed = measured_density(body)
    editor = Editor(author(), body.reason)
    with opened_database() as database:
        if study is None:
            _print_version(add_density(database, key, density, editor))
            return
        row = add_study_density(database, study, Measurement(key, density, weighed), editor)
    print(
        f"{row.food_key}: {row.g_per_ml:.3f} +- {row.sd_g_per_ml:.3f} g/ml in study {study}, density {row.id}"
    )


@foods_cli.command("restore")
def foods_restore(
    key: KeyArgument,
    version: Annotated[int, typer.Argument(help="A version in `tada foods changes KEY`.")],
    reason: Annotated[str, typer.Option(help="Why, for the history.")],
) -> None:
    """Restore an earlier version of a food by creating a version that equals it."""
    from app.foods.edits.edit_food import Editor, restore_food
    from app.foods.edits.schemas import RestoreIn

    body = _body(RestoreIn, {"version": version}, reason)
    with opened_database() as database:
        _print_version(restore_food(database, key, body.version, Editor(author(), body.reason)))


@foods_cli.command("changes")
def foods_changes(key: KeyArgument, as_json: JsonOption = False) -> None:
    """List the changes of a food, the newest first."""
    from app.foods.edits.api import render_changes
    from app.foods.edits.edit_food import list_changes

    with opened_database() as database:
        changes = render_changes(list_changes(database, key))
    if as_json:
        print(changes.model_dump_json())
        return
    if not changes.items:
        print("It is as it was imported.")
    for change in changes.items:
        print(
            f"version {change.version}  {change.changed_at:%Y-%m-%d %H:%M} UTC  {change.author}: {change.reason}"
        )
        for field, (old, new) in change.differences.items():
            print(f"  {field}: {_short(old)} -> {_short(new)}")


def _print_version(view: "FoodView") -> None:
    print(f"{view.value.key}: version {view.food.version} of {view.release} is in force")


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return "unknown" if value is None else text if len(text) <= 100 else text[:97] + "..."


def _read_object(file: Path) -> dict[str, object]:
    document = read_json(file)
    if not isinstance(document, dict):
        raise InvalidInputError(f"{file} holds no JSON object.")
    return document


def _set(document: dict[str, object], change: str) -> None:
    """Set `FIELD=VALUE` in the document; the field `nutrients.VITC` is in the object `nutrients`."""
    name, equals, text = change.partition("=")
    if not equals:
        raise InvalidInputError(f"--set takes FIELD=VALUE, not {change!r}.")
    try:
        value = json.loads(text)
    except ValueError:
        value = text
    group, dot, part = name.partition(".")
    if dot:
        parts = document.setdefault(group, {})
        if not isinstance(parts, dict):
            raise InvalidInputError(f"{group} has no field {part}.")
        parts[part] = value
    else:
        document[name] = value


def _specimen(text: str) -> dict[str, float]:
    volume_ml, _, mass_g = text.partition(":")
    try:
        return {"volume_ml": float(volume_ml), "mass_g": float(mass_g)}
    except ValueError:
        raise InvalidInputError(f"--specimen takes ML:G, such as 200:168, not {text!r}.") from None


def _body(model: type[Model], document: dict[str, object], reason: str | None) -> Model:
    """Validate the document like the API."""
    from pydantic import ValidationError

    try:
        return model.model_validate(document if reason is None else document | {"reason": reason})
    except ValidationError as error:
        problems = [
            f"{'.'.join(map(str, item['loc'])) or 'it'}: {item['msg']}" for item in error.errors()
        ]
        raise InvalidInputError(f"This cannot be accepted: {'; '.join(problems[:5])}.") from None


@vessels_cli.command("list")
def vessels_list(study: StudyArgument, as_json: JsonOption = False) -> None:
    """List the study's vessels by name, retired ones too."""
    from app.vessels.study_vessels import all_vessels

    with opened_database() as database:
        views = all_vessels(database, study)
    if as_json:
        from app.vessels.api import render_vessel

        print(
            json.dumps(
                [render_vessel(view).model_dump(mode="json") for view in views], ensure_ascii=False
            )
        )
        return
    for view in views:
        model = view.model
        capacity = (
            f"{view.held_ml:.0f} ml by its {view.held_by}"
            if view.held_ml is not None
            else "not known"
        )
        retired = "  retired" if view.version.is_retired else ""
        print(
            f"{model.name:<32} {model.kind:<10} rim {model.rim_diameter_mm:g} mm, height {model.height_mm:g} mm, "
            f"{capacity}{retired}"
        )


@vessels_cli.command("import")
def vessels_import(
    study: StudyArgument,
    path: Annotated[Path, typer.Argument(metavar="FILE.json", help="A list of vessels.")],
) -> None:
    """Add the vessels of a file, or change those of the same name; all or none (docs/vessels.md)."""
    from app.vessels.study_vessels import VesselAuthor, import_vessels

    value = read_json(path)
    with opened_database() as database:
        report = import_vessels(database, study, value, VesselAuthor(author()))
    print(f"{report.added} added, {report.changed} changed, {report.unchanged} unchanged")


@vessels_cli.command("export")
def vessels_export(study: StudyArgument) -> None:
    """Print the vessels in use, in the format of `tada vessels import` and `tada estimate --vessels`."""
    from app.vessels.study_vessels import export_vessels

    with opened_database() as database:
        library = export_vessels(database, study)
    json.dump(library, sys.stdout, ensure_ascii=False, indent=1)
    print()


@vessels_cli.command("remove")
def vessels_remove(
    study: StudyArgument, name: Annotated[str, typer.Argument(help="The vessel's name.")]
) -> None:
    """Retire a vessel: new estimates do not use it. It remains visible."""
    from app.vessels.study_vessels import VesselAuthor, retire_vessel

    with opened_database() as database:
        view = retire_vessel(database, study, name, VesselAuthor(author()))
    print(f"{view.vessel.name} is retired.")
