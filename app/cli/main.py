"""The `tada` command. Each command reads its arguments, calls one use case and prints the result.

Commands import their modules when they run, so that `tada estimate` does not load a web framework.
Errors are printed as sentences on standard error. Exit status 0: success, 1: a negative result, 2:
wrong usage or input.
"""

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import ValidationError

from app import __version__
from app.cli.backup import backup, restore
from app.cli.benchmark import benchmark
from app.cli.conformance import conformance_cli
from app.cli.database import JsonOption, author, opened_database, unmigrated_database
from app.cli.foods import foods_cli, vessels_cli
from app.cli.index import index_cli
from app.cli.jobs import jobs_cli
from app.cli.people import admin_cli, staff_cli
from app.cli.releases import releases_cli, sql
from app.cli.remeasure import remeasure
from app.core.errors import Failure, InvalidInputError, TadaError
from app.core.process_life import keep_files_private
from app.core.settings import Settings
from app.vision.marker_spec import DEFAULT_MARKER

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

    from app.vision.model import Photo

WHAT_NEXT = """To begin: `tada demo` shows one meal from upload to record.

`tada serve` runs a server on ./data; `tada staff create NAME --admin` makes an account for its pages at /dashboard.
"""
cli = typer.Typer(
    name="tada",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Dietary assessment.",
    epilog=WHAT_NEXT,
)
records_cli = typer.Typer(no_args_is_help=True, help="Effective records.")
db_cli = typer.Typer(no_args_is_help=True, help="The database.")
for name, group in (
    ("foods", foods_cli),
    ("index", index_cli),
    ("records", records_cli),
    ("releases", releases_cli),
    ("db", db_cli),
    ("jobs", jobs_cli),
    ("admin", admin_cli),
    ("staff", staff_cli),
    ("vessels", vessels_cli),
    ("conformance", conformance_cli),
):
    cli.add_typer(group, name=name)
cli.command()(backup)
cli.command()(restore)
cli.command()(benchmark)
cli.command()(remeasure)
cli.command()(sql)

MIN_SHOWN_PROBABILITY = 0.05  # of candidates printed with an estimate
MIN_LISTED_PROBABILITY = 0.001  # of candidates printed by `tada identify`, as in a meal
MarkerOption = Annotated[
    str,
    typer.Option(
        "--marker", metavar="M", help="Such as plain:9x7:11; aruco and charuco boards: docs/cli.md."
    ),
]


def main() -> None:
    """Run the command; print a TadaError as a sentence, without a traceback."""
    keep_files_private()
    try:
        cli()
    except TadaError as error:
        fail(error.message)
    except ValidationError as error:
        if error.title != Settings.__name__:
            raise
        fail(
            " ".join(
                f"{_variable(item)}: {item['msg']}." for item in error.errors(include_input=False)
            )
        )


def _variable(error: "ErrorDetails") -> str:
    """Return the variable of an invalid setting; never its value, which may be a secret."""
    name = str(error["loc"][0]) if error["loc"] else "settings"
    return name.upper() if name.upper().startswith("TADA_") else f"TADA_{name.upper()}"


def fail(message: str, status: int = 2) -> None:
    """Print an error and exit."""
    print(f"tada: {message}", file=sys.stderr)
    raise SystemExit(status)


@cli.command()
def version() -> None:
    """Print the version."""
    print(__version__)


@cli.command()
def serve(
    worker: Annotated[
        bool, typer.Option(help="Run a worker too, if the database is embedded.")
    ] = True,
    processes: Annotated[
        int, typer.Option(min=1, max=64, help="Processes that answer requests together.")
    ] = 1,
) -> None:
    """Run the HTTP server and, with the embedded database, a worker."""
    from app.metrics.shared_metrics import share_metrics

    settings = Settings()
    if processes > 1:
        share_metrics()  # before the program is imported
    from app.cli.serving import serve as run

    raise SystemExit(run(settings, with_worker=worker, processes=processes))


@cli.command()
def worker() -> None:
    """Run a worker: any number of them, on any machine that reaches database and store."""
    from app.worker import run_worker

    raise SystemExit(run_worker(Settings()))


@cli.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the pictures.")] = Path(
        "demo-output"
    ),
    browse: Annotated[
        bool,
        typer.Option(
            "--browse", help="Fill a sample study instead, and serve it to a browser until Ctrl-C."
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the sample study.")] = 1,
    port: Annotated[
        int,
        typer.Option(min=0, max=65535, help="Port of the sample study's server; 0: any free one."),
    ] = 0,
) -> None:
    """Run through server, upload, estimate and records on throwaway data; print records and write pictures."""
    if browse:
        from app.cli.demo_study import browse_demo

        raise SystemExit(browse_demo(seed, port))
    from app.cli.demo import run_demo

    raise SystemExit(run_demo(output))


@cli.command()
def sandbox(
    server: Annotated[
        str | None,
        typer.Option(
            help="Address of a server, with an admin's TADA_TOKEN; default: a throwaway one."
        ),
    ] = None,
    study: Annotated[str, typer.Option(help="Code of the sandbox study.")] = "sandbox",
    send: Annotated[
        bool, typer.Option("--send", help="Send the bundled meals, from a phone of its own.")
    ] = False,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the throwaway server; 0: any free one.")
    ] = 0,
) -> None:
    """Open a sandbox study for trying an app: its address, an enrolment code and the answers that can be asked for."""
    from app.cli.sandbox import run_sandbox

    raise SystemExit(run_sandbox(study, server=server, sends=send, port=port))


@cli.command()
def estimate(
    photographs: Annotated[
        list[Path],
        typer.Argument(
            help="Photographs from the left, from the right, then up to six others; or one alone."
        ),
    ],
    marker: Annotated[
        str | None,
        typer.Option(
            metavar="M", help=f"Such as {DEFAULT_MARKER}, which holds where nothing is given."
        ),
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="Camera file (JSON), as `tada calibrate --json` prints.")
    ] = None,
    rig: Annotated[
        Path | None, typer.Option(help="Stereo rig's file (JSON): no marker is needed.")
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(help="File of the cameras' poses (JSON), with --camera: no marker is needed."),
    ] = None,
    depth: Annotated[
        list[str] | None,
        typer.Option(metavar="VIEW=FILE", help="Depth map of a photograph: 16 bit PNG or TIFF."),
    ] = None,
    depth_camera: Annotated[
        Path | None, typer.Option(help="Intrinsics of the depth map (JSON).")
    ] = None,
    depth_confidence: Annotated[
        list[str] | None,
        typer.Option(metavar="VIEW=FILE", help="Confidence of a depth map: 8 bit PNG."),
    ] = None,
    method: Annotated[
        str, typer.Option(help="Method of volume estimation: shape, paper or paper-strict.")
    ] = "shape",
    hint: Annotated[
        list[str] | None,
        typer.Option(help='JSON: {"point": \\[x, y], "food": KEY}, "box", "polygon".'),
    ] = None,
    complete: Annotated[
        bool, typer.Option("--complete", help="The hints cover all foods.")
    ] = False,
    vessels: Annotated[
        Path | None, typer.Option(help="Vessel library (JSON): measured mugs and bowls.")
    ] = None,
    debug: Annotated[Path | None, typer.Option(help="Folder for a picture of each step.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate the volumes of the foods in one or more photographs of a meal, without a server."""
    from app.children.cores import THREAD_VARIABLES

    # before libraries are loaded, which would only compete
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    from app.meals.estimate.estimate_files import estimate_files, read_options

    options = read_options(
        marker=marker,
        camera=camera,
        rig=rig,
        poses=poses,
        method=method,
        hints=hint or [],
        is_complete=complete,
        vessels=vessels,
        has_depth=bool(depth),
    )
    announce = (
        None if as_json else lambda stage: print(f"  {stage} ...", file=sys.stderr, flush=True)
    )
    settings = Settings()
    estimated = estimate_files(
        photographs,
        options,
        max_pixels=settings.max_photo_pixels,
        debug=debug,
        on_stage=announce,
        index=settings.food_index,
        depths=depth or [],
        depth_camera=depth_camera,
        confidences=depth_confidence or [],
    )
    if as_json:
        print(json.dumps(estimated))
    else:
        print_estimate(estimated, debug)
    raise SystemExit(1 if estimated["failure"] else 0)


@cli.command()
def identify(
    photo: Annotated[Path, typer.Argument(help="A photograph of food.")],
    box: Annotated[
        str | None,
        typer.Option(metavar="X,Y,W,H", help="Box around the food, px upright; default: detected."),
    ] = None,
    marker: Annotated[
        str | None,
        typer.Option(metavar="M", help="A marker in the photograph, to correct its colours."),
    ] = None,
    index: Annotated[
        Path | None,
        typer.Option(
            help="An index by `tada index build`; default: TADA_FOOD_INDEX, or the shipped one."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Identify the food in a photograph by an index of foods."""
    from app.candidates.identify_photo import identified_to_json, identify_photo, parse_box
    from app.vision.looks.vcm_region import SIDE_PX
    from app.vision.marker_spec import parse_marker

    food_box = parse_box(box) if box is not None else None
    spec = parse_marker(marker) if marker is not None else None
    identified = identified_to_json(
        identify_photo(
            read_photo_or_fail(photo, least_short_side_px=SIDE_PX),
            food_box,
            spec,
            index or Settings().food_index,
        )
    )
    if as_json:
        print(json.dumps(identified))
        return
    for number, place in enumerate([identified, *identified["others"]]):
        if number > 0:
            print("and, in another place:")
        for candidate in [*place["groups"], *place["candidates"][:5]]:
            if candidate["probability"] >= MIN_LISTED_PROBABILITY:
                print(f"{candidate['probability']:6.1%}  {candidate['food']}")
        print(f"{place['none_of_these']:6.1%}  none that the index knows")


@cli.command()
def calibrate(
    photos: Annotated[
        list[Path], typer.Argument(help="Photographs of the board, at different angles.")
    ],
    marker: MarkerOption = DEFAULT_MARKER,
    is_rig: Annotated[
        bool,
        typer.Option(
            "--rig",
            help="A stereo rig: the left camera's photographs, then as many of the right one.",
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Compute a camera's intrinsics from photographs of a board, or a rig's: the file's keys and rms_px."""
    from app.meals.estimate.calibrate import calibrate_camera_files, calibrate_rig_files

    calibrated = (calibrate_rig_files if is_rig else calibrate_camera_files)(
        photos, marker, read_photo_or_fail
    )
    if isinstance(calibrated, Failure):
        return fail(f"{calibrated.message} {calibrated.advice}".strip(), 1)
    if as_json:
        print(json.dumps(calibrated.document))
        return None
    print("\n".join(f"{key:<12} {value}" for key, value in calibrated.document.items()))
    for name, failure in calibrated.left_out:
        print(f"left out: {name}: {failure.message}", file=sys.stderr)
    return None


@cli.command("marker")
def marker_command(
    marker: MarkerOption = DEFAULT_MARKER,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="PDF to write.")] = None,
    find: Annotated[Path | None, typer.Option(help="Photograph to search for the board.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Write the printable board at true size (-o), or find it in a photograph (--find)."""
    from app.meals.estimate.estimate_json import colour_to_json
    from app.vision.board.colour_correction import measure_colour
    from app.vision.board.marker import find_marker
    from app.vision.marker_spec import parse_marker

    spec = parse_marker(marker)
    if (output is None) == (find is None):
        raise InvalidInputError(
            "Give either -o FILE.pdf to write the board or --find PHOTO to find it."
        )
    if output is not None:
        from app.people.print_marker import render_marker_pdf

        output.write_bytes(render_marker_pdf(spec))
        print(
            f"{output}: print at 100 % (no fitting to the page) and check the ruler.",
            file=sys.stderr,
        )
        return
    if find is None:
        return
    photo = read_photo_or_fail(find)
    marker_view = find_marker(photo, spec)
    corners = None if isinstance(marker_view, Failure) else marker_view.corners_px.round(3).tolist()
    colour = (
        None
        if isinstance(marker_view, Failure)
        else colour_to_json(measure_colour(photo, marker_view))
    )
    point_ids = None if isinstance(marker_view, Failure) else marker_view.point_ids
    document: dict[str, object] = {
        "found": corners is not None,
        "marker": str(spec),
        "corners_px": corners,
        "corner_ids": None if point_ids is None else point_ids.tolist(),
        "colour": colour,
    }
    if isinstance(marker_view, Failure):
        document["failure"] = {
            "code": marker_view.code,
            "message": marker_view.message,
            "advice": marker_view.advice,
        }
    if as_json:
        print(json.dumps(document))
    elif isinstance(marker_view, Failure):
        print(
            f"{find}: not found ({marker_view.code}). {marker_view.message} {marker_view.advice}".strip()
        )
    else:
        points = "corners of tags" if spec.points_are_tags else "inner corners"
        print(f"{find}: {spec} found, {len(marker_view.corners_px)} {points}.")
        if colour is not None and colour["delta_e_worst"] is not None:
            print(
                f"{find}: after correction its worst square has a CIEDE2000 of {colour['delta_e_worst']}."
            )
    raise SystemExit(0 if corners is not None else 1)


@records_cli.command("rebuild")
def records_rebuild(
    check: Annotated[bool, typer.Option("--check", help="Only compare; change nothing.")] = False,
) -> None:
    """Rebuild the effective records from runs and items; or check that they are up to date."""
    from app.records.recompute_records import rebuild_records

    with opened_database() as database:
        records = rebuild_records(database, write=not check)
    print(
        f"{records.compared} records compared, {records.different} differ"
        + ("" if check else ", rebuilt")
    )
    raise SystemExit(1 if check and records.different else 0)


@records_cli.command("recompute")
def records_recompute(
    nutrients: Annotated[
        bool, typer.Option("--nutrients", help="Grams and nutrients, by the tables now in force.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only show what would change.")
    ] = False,
    study: Annotated[str | None, typer.Option(help="Only this study's records.")] = None,
    reason: Annotated[str, typer.Option(help="Why, for the history.")] = "",
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object per line, the summary last.")
    ] = False,
) -> None:
    """Create new records where foods or figures have changed; volumes, chosen foods and old records stay."""
    from app.records.recompute_records import RecordDifference, recompute_nutrients

    if not nutrients:
        raise InvalidInputError("Choose what to recompute: --nutrients.")

    def print_difference(difference: RecordDifference) -> None:
        if as_json:
            columns = {
                name: {"before": before, "after": after}
                for name, (before, after) in difference.columns.items()
            }
            document = {
                "item": str(difference.item_id),
                "meal": str(difference.meal_id),
                "food": difference.food_key,
            }
            print(json.dumps(document | {"changes": columns}))
            return
        shown = ", ".join(
            f"{name} {_figure(before)} -> {_figure(after)}"
            for name, (before, after) in difference.columns.items()
        )
        print(
            f"meal {difference.meal_id}  {difference.food_key}: {shown or 'other components, or their source'}"
        )

    with opened_database() as database:
        report = recompute_nutrients(
            database,
            write=not dry_run,
            author=author(),
            reason=reason,
            study_code=study,
            tell=print_difference,
        )
    if as_json:
        print(
            json.dumps(
                {
                    "compared": report.compared,
                    "changed": report.changed,
                    "dry_run": dry_run,
                    "gone": report.gone,
                }
            )
        )
        return
    print(
        f"{report.compared} records compared, {report.changed} {'would change' if dry_run else 'recomputed'}"
    )
    if report.gone:
        shown = ", ".join(f"{key} ({count})" for key, count in report.gone.most_common(5))
        more = ", ..." if len(report.gone) > 5 else ""
        print(
            f"not changed: {report.gone.total()} records of foods in no table in force: {shown}{more}"
        )


@db_cli.command("upgrade")
def db_upgrade(
    revision: Annotated[
        str | None, typer.Option(help="Only migrate the schema, up to this revision.")
    ] = None,
) -> None:
    """Migrate the schema and load the starter food table."""
    from app.db.migrate import upgrade

    if revision is None:
        with opened_database():
            print("The database is up to date.")
        return
    with unmigrated_database() as database:
        upgrade(database, revision)
    print(f"The schema is at {revision}.")


@db_cli.command("current")
def db_current() -> None:
    """Print the schema's revision and whether it is older than, current for or newer than this program."""
    from app.db.schema_state import SchemaState, current_revision, head_revision, schema_state

    with unmigrated_database() as database:
        revision, state = current_revision(database), schema_state(database)
    print(f"{revision or 'none'}: {state.value}; this program was written for {head_revision()}")
    raise SystemExit(1 if state is SchemaState.OLDER else 0)


@cli.command()
def doctor(
    requeue: Annotated[
        bool, typer.Option("--requeue", help="Also queue stuck meals again.")
    ] = False,
    trusts_clock: Annotated[
        bool,
        typer.Option(
            "--trust-clock", help="Trust the clock as it is now, without waiting for a day."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check a deployment, report problems and their remedies. Status 1: there are problems."""
    from dataclasses import asdict

    from app.cli.database import unmigrated_database
    from app.operations.chores import trust_clock
    from app.operations.doctor.doctor import examine

    with unmigrated_database() as database:
        if trusts_clock:
            with database.write() as session:
                trust_clock(session)
        findings = examine(database, Settings(), requeue=requeue)
    if as_json:
        print(json.dumps({"findings": [asdict(finding) for finding in findings]}))
    else:
        for finding in findings:
            print(finding)
    raise SystemExit(0 if all(finding.is_ok for finding in findings) else 1)


def read_photo_or_fail(path: Path, *, least_short_side_px: int | None = None) -> "Photo":
    """Return a photograph of a file.

    Raises InvalidInputError. least_short_side_px: None: what a marker needs.
    """
    from app.vision.photograph.photo import MIN_SHORT_SIDE_PX, read_photo

    try:
        data = path.read_bytes()
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read: {error.strerror}.") from None
    least = MIN_SHORT_SIDE_PX if least_short_side_px is None else least_short_side_px
    photo = read_photo(data, max_pixels=Settings().max_photo_pixels, least_short_side_px=least)
    if isinstance(photo, Failure):
        raise InvalidInputError(f"{path}: {photo.message} {photo.advice}".strip(), code=photo.code)
    return photo


def _figure(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4g}"


def print_estimate(estimated: dict[str, Any], debug: Path | None) -> None:
    """Print the result of `tada estimate` as text."""
    failure = estimated["failure"]
    if failure:
        print(f"Not measured ({failure['code']}): {failure['message']} {failure['advice']}".strip())
    for number, item in enumerate(estimated["items"], 1):
        line = f"item {number}: not measured"
        if item["volume_ml"] is not None:
            low, high = item["volume_interval_ml"]
            line = f"item {number}: {item['volume_ml']:.1f} ml (90 %: {low:.1f} to {high:.1f})"
        if item["food"]:
            line += f", {item['food']['name']}"
        if item["mass_g"] is not None:
            line += f": {item['mass_g']:.0f} g, {item['energy_kcal']:.0f} kcal"
        print(line + (f"  [{', '.join(item['flags'])}]" if item["flags"] else ""))
        likely = [
            match for match in item["candidates"] if match["probability"] >= MIN_SHOWN_PROBABILITY
        ][:3]
        if likely:
            print(
                "        looks like "
                + ", ".join(f"{match['food']} ({match['probability']:.0%})" for match in likely)
            )
    print(
        f"{estimated['seconds']:.2f} s, method {estimated['method']} {estimated['pipeline_version']}"
    )
    if debug is not None:
        print(f"pictures in {debug}")


if __name__ == "__main__":
    main()
