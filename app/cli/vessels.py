"""`tada vessels`: list, import and export a study's vessel library."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from app.cli.database import JsonOption, author, opened_database, read_json

vessels_cli = typer.Typer(no_args_is_help=True, help="A study's measured mugs and bowls.")

StudyArgument = Annotated[str, typer.Argument(metavar="STUDY", help="The study's code.")]


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
