"""`tada demo --browse`: a sample study on a throwaway server, to be looked at in a browser until Ctrl-C."""

import signal
import tempfile
import time
from pathlib import Path
from types import FrameType

import httpx2

from app.db.session import Database
from app.demo import answer, running_server, say, throwaway_settings
from app.demo_study import STUDY, SampleStudy, make_study, photograph_meals, settle, tell_days
from app.services.prepare import prepare
from app.services.staff import create_admin

ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def browse_demo(seed: int, port: int) -> int:
    """Run it; port 0: any free one. Returns the exit status."""
    for number in ENDINGS:
        signal.signal(number, _interrupt)  # SIGINT too: whom a shell starts in the background ignores it
    try:
        with tempfile.TemporaryDirectory(prefix="tada-demo-") as folder:
            settings = throwaway_settings(Path(folder), port=port)
            say("A throwaway server: SQLite and files in a temporary folder, removed at the end.")
            database = Database(settings.resolved_database_url)
            try:
                prepare(database, settings)
                token = create_admin(database, "demo")
            finally:
                database.dispose()
            with (
                running_server(settings) as address,
                httpx2.Client(base_url=address, headers={"Authorization": f"Bearer {token}"}, timeout=60) as admin,
            ):
                _browse(address, admin, seed)
    except KeyboardInterrupt:
        say("Done; the folder is removed.")
    return 0


def _browse(address: str, admin: httpx2.Client, seed: int) -> None:
    """Fill the server, tell where to look, and wait to be interrupted."""
    study = make_study(admin)
    try:
        photograph_meals(study, seed)
        tell_accounts(address, study)
        tell_days(study, seed)
        say("Two weeks of six people's days are told.")
        with httpx2.Client(base_url=address, timeout=60) as reviewer:
            rene = next(account for account in study.accounts if account.role == "reviewer")
            session = answer(reviewer.post("/v1/sessions", json={"name": rene.name, "password": rene.password}))
            reviewer.headers["Authorization"] = f"Bearer {session['token']}"
            ended = settle(study, reviewer)
        told = ", ".join(f"{count} {status}" for status, count in sorted(ended.items()))
        say(f"Photographed meals are measured: {told}; one waits for its other photograph.")
        say("Ctrl-C ends the server and removes its data.")
        while True:
            time.sleep(3600)
    finally:
        study.close()


def tell_accounts(address: str, study: SampleStudy) -> None:
    """Print where to sign in, and as whom."""
    say(f"Look at it: {address}/dashboard/studies/{STUDY}")
    for account in study.accounts:
        print(f"   {account.role:<9} {account.name:<6} password {account.password}")
    say("Photographed meals are being measured and days filled, as phones send them; the pages show it live.")


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Whatever ends it ends it as Ctrl-C does, once: the second must not break off the removal of the folder."""
    for number in ENDINGS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
