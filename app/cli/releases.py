"""`tada releases` and `tada sql`: list and check releases; query the tables that exports have."""

import json
import shutil
import sys
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.database import JsonOption, opened_database

if TYPE_CHECKING:
    from app.exports.releases.compare_release import Comparison

releases_cli = typer.Typer(no_args_is_help=True, help="A study's data, frozen under a name.")

StudyArgument = Annotated[str, typer.Argument(metavar="STUDY", help="The study's code.")]
NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="The release's name.")]


@releases_cli.command("check")
def releases_check(study: StudyArgument, name: NameArgument, as_json: JsonOption = False) -> None:
    """Verify a release's files, and whether the same filters would give the same data now.

    Status 1: a file is missing or damaged, or the current data differ.
    """
    from app.core.settings import Settings
    from app.exports.releases.compare_release import compare_release
    from app.storage.opening import open_blob_store

    settings = Settings()
    with opened_database() as database:
        comparison = compare_release(
            database, open_blob_store(settings.resolved_blob_url, settings), study, name
        )
    checked = comparison.checked
    if as_json:
        document = {
            "is_whole": checked.is_whole,
            "is_reproduced": comparison.is_reproduced,
            "checksum": checked.release.checksum,
            "checksum_now": comparison.checksum_now,
            "altered_at": checked.release.altered_at,
            "files": [
                {
                    "name": file.name,
                    "blob_key": file.blob_key,
                    "sha256": file.sha256,
                    "found": file.state,
                }
                for file in checked.files
            ],
            "tables": None
            if comparison.tables is None
            else [asdict(table) for table in comparison.tables],
        }
        print(json.dumps(document, default=str))
    else:
        _print_comparison(comparison)
    if not (checked.is_whole and comparison.is_reproduced):
        raise typer.Exit(1)


@releases_cli.command("list")
def releases_list(study: StudyArgument, as_json: JsonOption = False) -> None:
    """List the study's releases, the newest first."""
    from app.exports.releases.compare_release import releases_of_study

    with opened_database() as database:
        releases = releases_of_study(database, study)
    if as_json:
        names = ("name", "state", "checksum", "frozen_at", "altered_at", "note")
        print(
            json.dumps(
                [{name: getattr(release, name) for name in names} for release in releases],
                default=str,
            )
        )
        return
    for release in releases:
        at = (
            release.frozen_at.isoformat(timespec="seconds")
            if release.frozen_at is not None
            else "-"
        )
        print(f"{at}  {release.state:8}  {release.checksum or '-':64}  {release.name}")


def _print_comparison(comparison: "Comparison") -> None:
    checked = comparison.checked
    for file in checked.files:
        if file.state != "whole":
            print(f"{file.name}: {file.state}, {file.blob_key}")
    print(
        f"files: {'whole' if checked.is_whole else 'NOT as frozen'}, checksum {checked.release.checksum}"
    )
    if checked.release.altered_at is not None:
        print(
            f"last altered by an erasure on {checked.release.altered_at.isoformat(timespec='seconds')}"
        )
    if comparison.is_reproduced:
        print("frozen now, it would be the same")
        return
    print(f"frozen now, it would be another: checksum {comparison.checksum_now}")
    if comparison.tables is None:
        print("  differences of rows are not shown without its files")
        return
    for table in comparison.tables:
        if table.is_same and not table.columns:
            continue
        print(
            f"  {table.table}: {table.same} rows the same, {table.other} others, {table.only_frozen} only in the "
            f"release, {table.only_now} only now"
        )
        if table.columns:
            print(
                f"    {', '.join(f'{name} ({count})' for name, count in sorted(table.columns.items()))}"
            )
    if all(table.is_same and not table.columns for table in comparison.tables):
        print("  every row is the same, but this version of the program writes other bytes")


def sql(
    query: Annotated[str, typer.Argument(metavar="QUERY", help="A SELECT, in DuckDB's SQL.")],
    study: Annotated[
        str | None, typer.Option("--study", metavar="CODE", help="Only this study's rows.")
    ] = None,
) -> None:
    """Query records, meals, days, photographs, participants and components; nothing is changed.

    A table on a terminal, CSV elsewhere. The columns are those of the data dictionary.
    """
    import duckdb

    from app.core.errors import InvalidInputError
    from app.core.settings import Settings
    from app.exports.live_tables import live_tables
    from app.exports.table_selects import show_tables

    url = Settings().resolved_database_url
    with TemporaryDirectory() as folder:
        try:
            with live_tables(url, Path(folder)) as connection:
                show_tables(connection, study)
                rows = connection.sql(query)
                if rows is not None and sys.stdout.isatty():
                    rows.show()
                elif rows is not None:
                    path = Path(folder) / "rows.csv"
                    rows.write_csv(str(path))
                    with path.open("rb") as file:
                        shutil.copyfileobj(file, sys.stdout.buffer)
        except duckdb.Error as error:
            raise InvalidInputError(str(error)) from None
