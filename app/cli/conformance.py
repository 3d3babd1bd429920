"""`tada conformance`: a server that judges the apps that talk to it, and a phone that judges a server."""

import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from app.core.settings import Settings

conformance_cli = typer.Typer(
    no_args_is_help=True, help="Try whether an app or a server does what docs/apps.md asks."
)

STUDY, PARTICIPANT = "conformance", "P001"


@conformance_cli.command("serve")
def serve_conformance(
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 for phones on the same network.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to listen on.")] = 8010,
    url: Annotated[
        str | None, typer.Option(help="Address that phones use; default: http://HOST:PORT.")
    ] = None,
) -> None:
    """Run a throwaway server that records what an app does, disturbs it, and shows a check list at /conformance."""
    from app.cli.demo import throwaway_settings
    from app.cli.serving import serve
    from app.extras.conformance.observer import Observer

    address = url or f"http://{host}:{port}"
    with tempfile.TemporaryDirectory(prefix="tada-conformance-") as folder:
        settings = throwaway_settings(Path(folder), public_url=address, host=host, port=port)
        code = _prepare_with_study(settings)
        print(f"   server          {address}")
        print(f"   enrolment code  {code}")
        print(f"   a browser       {address}/capture/#code={code}")
        print(f"   check list      {address}/conformance   (JSON: {address}/conformance.json)")
        print(
            "   Send two meals of two photographs, correct one, erase the other (docs/conformance.md). Ctrl-C ends.",
            flush=True,
        )
        raise SystemExit(serve(settings, with_worker=True, around=Observer))


@conformance_cli.command("run")
def run_conformance(
    url: Annotated[str, typer.Argument(help="Address of the server.")],
    code: Annotated[
        str,
        typer.Option(
            help="Enrolment code of a participant for this trial, who is withdrawn at its end. It is used before the "
            "command can see whether the study is a sandbox."
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for report.html and report.json.")
    ] = None,
    any_study: Annotated[
        bool, typer.Option("--any-study", help="Also where the study is no sandbox.")
    ] = False,
) -> None:
    """Play a phone against a server, with lost answers and broken uploads.

    Exit status 0: all required checks pass.
    """
    import httpx2

    from app.cli.demo import bundled_photograph
    from app.core.errors import InvalidInputError
    from app.extras.conformance.report import WORDS, render_page, report_of
    from app.extras.conformance.server_checks import try_server
    from app.extras.conformance.server_phone import CALL_SECONDS, document, enrol
    from app.extras.conformance.verdict import is_conforming

    pair = {slot: bundled_photograph("", slot) for slot in ("left", "right")}
    with httpx2.Client(base_url=url.rstrip("/"), timeout=CALL_SECONDS) as client:
        try:
            answer, phone = enrol(client, code, pair)
        except httpx2.HTTPError as error:
            raise InvalidInputError(f"{url} does not answer: {error}.") from None
        if phone is None:
            raise InvalidInputError(
                f"The code enrols no phone: {answer.status_code} {answer.text[:300]}"
            )
        study = document(phone.call("GET", "/v1/me")).get("study")
        if not any_study and not (isinstance(study, dict) and study.get("sandbox")):
            phone.call("DELETE", "/v1/me/device")
            raise InvalidInputError(
                "The study is no sandbox: use a sandbox's code, or add --any-study. This code is spent; the phone that "
                "it enrolled is signed out."
            )
        results = try_server(phone)
    for result in results:
        advice = "" if result.is_required else " (advice)"
        print(
            f"{WORDS[result.verdict.outcome]:<12} {result.name:<20} {result.title}{advice}: {result.verdict.detail}"
        )
    if output is not None:
        report = [report_of(url, results)]
        output.mkdir(parents=True, exist_ok=True)
        (output / "report.html").write_text(render_page(report), encoding="utf-8")
        (output / "report.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    raise SystemExit(0 if is_conforming(results) else 1)


def _prepare_with_study(settings: "Settings") -> str:
    """Prepare a new deployment with a sandbox study, without a server.

    Returns an enrolment code.
    """
    from app.cli.demo import MARKER
    from app.db.session import Database
    from app.operations.prepare import prepare
    from app.people.access.secret_box import open_secret_box
    from app.people.devices import issue_enrolment_code
    from app.people.participants import create_participant
    from app.people.studies import ProtocolChange, create_study

    protocol: ProtocolChange = {"marker": MARKER, "gives_feedback": True}
    database = Database(settings.resolved_database_url)
    try:
        prepare(database, settings)
        create_study(database, code=STUDY, name="Conformance", protocol=protocol, is_sandbox=True)
        box = open_secret_box(settings)
        create_participant(database, box, study_code=STUDY, code=PARTICIPANT)
        return issue_enrolment_code(database, study_code=STUDY, participant_code=PARTICIPANT).code
    finally:
        database.dispose()
