"""The ways to a database and to a store on other machines: by TLS to who has the right certificate, to nobody else."""

import os
import socket
import subprocess
import sys
from functools import partial

import pytest
import sqlalchemy as sa

from app.db.session import Database, normalise_url
from tests.support.s3_places import s3_environment
from tests.support.tls_front import Authority, TlsFront

READ_AND_WRITE = """
from app.core.settings import Settings
from app.storage.opening import open_blob_store
settings = Settings()
store = open_blob_store(settings.resolved_blob_url, settings)
store.put_bytes("a/photo", b"a photograph")
print(store.read("a/photo").decode())
"""


@pytest.fixture
def authority(tmp_path):
    return Authority(tmp_path)


@pytest.fixture
def stranger(tmp_path):
    """Another authority, of the same name."""
    folder = tmp_path / "stranger"
    folder.mkdir()
    return Authority(folder)


def connect_to_postgres(server_url):
    """The server of the tests listens at a Unix socket alone."""
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(f"{sa.make_url(server_url).query['host']}/.s.PGSQL.5432")
    return connection


def database_by(front, server_url, **query):
    url = sa.make_url(normalise_url(server_url)).set(host="127.0.0.1", port=front.port).set(query=query)
    return Database(url.render_as_string(hide_password=False))


def select_one(database):
    try:
        with database.read() as session:
            return session.scalar(sa.text("SELECT 1"))
    finally:
        database.dispose()


def test_database_is_reached_by_tls_and_its_certificate_is_checked(authority, stranger, postgres_server):
    connect = partial(connect_to_postgres, postgres_server)
    with TlsFront(authority.server_context(), connect, asks_first=True) as front:
        checked = {"sslmode": "verify-full", "sslrootcert": str(authority.file)}
        assert select_one(database_by(front, postgres_server, **checked)) == 1
        assert front.ended > 0
        with pytest.raises(sa.exc.OperationalError, match="SSL error"):
            select_one(database_by(front, postgres_server, **checked | {"sslrootcert": str(stranger.file)}))
        with pytest.raises(sa.exc.OperationalError):
            select_one(database_by(front, postgres_server, sslmode="disable"))


@pytest.mark.slow
def test_store_is_reached_by_tls_and_its_certificate_is_checked(authority, stranger, s3_server, tmp_path):
    connect = partial(socket.create_connection, ("127.0.0.1", s3_server.port))
    with TlsFront(authority.server_context(), connect) as front:

        def program(trusted):
            environment = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(sys.path)}
            environment |= s3_environment(s3_server) | {"TADA_S3_ENDPOINT": f"https://127.0.0.1:{front.port}"}
            environment |= {"SSL_CERT_FILE": str(trusted), "TADA_DATA_DIR": str(tmp_path / "data")}
            command = [sys.executable, "-c", READ_AND_WRITE]
            return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)

        done = program(authority.file)
        assert (done.returncode, done.stdout.strip()) == (0, "a photograph"), done.stderr
        assert front.ended > 0
        refused = program(stranger.file)
        assert refused.returncode != 0
        assert "a photograph" not in refused.stdout
