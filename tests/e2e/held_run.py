"""A run that holds a PostgreSQL, an S3 server, a browser and a server, and does not end: for test_ended_run.py."""

import os
import pathlib
import threading

from tests.e2e.processes import Server


def test_holds_everything_until_it_is_ended(postgres_server, s3_server, chromium, tmp_path):
    server = Server(tmp_path)
    server.place_prepared_database()
    server.start()
    server.wait_until_ready()
    pathlib.Path(os.environ["HELD_RUN_IS_READY"]).write_text(os.environ["TMPDIR"])
    threading.Event().wait()
