"""The commands `tada releases ...`: those that there are; whether one is whole, and what it would be if frozen now."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.database import JsonOption, opened_database

if TYPE_CHECKING:
    from app.releases.compare_release import Comparison

releases_cli = typer.Typer(no_args_is_help=True, help="A study's data, frozen under a name.")

StudyArgument = Annotated[str, typer.Argument(metavar="STUDY", help="The study's code.")]
NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="The release's name.")]


@releases_cli.command("check")
def releases_check(study: StudyArgument, name: NameArgument, as_json: JsonOption = False) -> None:
    """Read a release's files back, and tell whether the same filters would give the same data now.

    Status 1: a file is missing or damaged, or the data of now are others.
    """
    from app.core.settings import Settings
    from app.releases.compare_release import compare_release
    from app.storage.opening import open_blob_store

    settings = Settings()
    with opened_database() as database:
        found = compare_release(database, open_blob_store(settings.resolved_blob_url, settings), study, name)
    checked = found.checked
    if as_json:
        told = {
            "is_whole": checked.is_whole,
            "is_reproduced": found.is_reproduced,
            "checksum": checked.release.checksum,
            "checksum_now": found.checksum_now,
            "altered_at": checked.release.altered_at,
            "files": [asdict(file) for file in checked.files],
            "tables": None if found.tables is None else [asdict(table) for table in found.tables],
        }
        print(json.dumps(told, default=str))
    else:
        _print_words(found)
    if not (checked.is_whole and found.is_reproduced):
        raise typer.Exit(1)


@releases_cli.command("list")
def releases_list(study: StudyArgument, as_json: JsonOption = False) -> None:
    """The study's releases, the newest first."""
    from app.releases.compare_release import releases_of_study

    with opened_database() as database:
        releases = releases_of_study(database, study)
    if as_json:
        names = ("name", "state", "checksum", "frozen_at", "altered_at", "note")
        print(json.dumps([{name: getattr(one, name) for name in names} for one in releases], default=str))
        return
    for one in releases:
        at = one.frozen_at.isoformat(timespec="seconds") if one.frozen_at is not None else "-"
        print(f"{at}  {one.state:8}  {one.checksum or '-':64}  {one.name}")


def _print_words(found: "Comparison") -> None:
    checked = found.checked
    for file in checked.files:
        if file.state != "whole":
            print(f"{file.name}: {file.state}, {file.blob_key}")
    print(f"files: {'whole' if checked.is_whole else 'NOT what was frozen'}, checksum {checked.release.checksum}")
    if checked.release.altered_at is not None:
        print(f"altered since something was erased, last on {checked.release.altered_at.isoformat(timespec='seconds')}")
    if found.is_reproduced:
        print("frozen now, it would be the same")
        return
    print(f"frozen now, it would be another: checksum {found.checksum_now}")
    if found.tables is None:
        print("  which rows differ is not told without its files")
        return
    for table in found.tables:
        if table.is_same and not table.columns:
            continue
        print(
            f"  {table.table}: {table.same} rows the same, {table.other} others, {table.only_frozen} only in the "
            f"release, {table.only_now} only now"
        )
        if table.columns:
            print(f"    {', '.join(f'{name} ({count})' for name, count in sorted(table.columns.items()))}")
    if all(table.is_same and not table.columns for table in found.tables):
        print("  every row is the same: another version of this program writes other bytes")
