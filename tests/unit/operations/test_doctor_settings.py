"""What the doctor says of the ways to database and store: nothing goes in the clear beyond this machine."""

import pytest

from app.core.settings import Settings
from app.operations.doctor.doctor import CHECKS
from app.operations.doctor.finding import Deployment


def ways(tmp_path, **settings):
    deployment = Deployment(None, Settings(data_dir=tmp_path, secret_key="k" * 40, **settings), requeue=False)
    verdicts = {check.subject: check.look(deployment) for check in CHECKS if check.subject.startswith("way to")}
    return {subject: verdict[0] for subject, verdict in verdicts.items() if verdict is not None}


@pytest.mark.parametrize(
    ("address", "level"),
    [
        ("tada:secret@db.example.org/tada", "bad"),
        ("tada:secret@db.example.org/tada?sslmode=require", "bad"),  # encrypted, and to whoever answers
        ("tada:secret@10.0.0.7/tada?sslmode=verify-ca&sslrootcert=ca.pem", "ok"),
        ("tada:secret@db.example.org/tada?sslmode=verify-full&sslrootcert=system", "ok"),
        ("/tada?host=db.example.org", "bad"),
        ("tada@postgres/tada", "note"),  # a container next door or another machine
        ("tada@localhost/tada", None),  # this machine needs none
        ("tada@/tada", None),
        ("/tada?host=/run/postgresql", None),
    ],
)
def test_database_elsewhere_wants_tls_that_looks_at_the_certificate(tmp_path, address, level):
    expected = {} if level is None else {"way to the database": level}
    assert ways(tmp_path, database_url=f"postgresql://{address}") == expected


def test_sslmode_may_stand_in_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("PGSSLMODE", "verify-full")
    assert ways(tmp_path, database_url="postgresql://tada@db.example.org/tada") == {"way to the database": "ok"}


@pytest.mark.parametrize(
    ("endpoint", "found"),
    [
        ("http://s3.example.org", {"way to the store": "bad"}),
        ("https://s3.example.org", {}),
        ("http://s3:8333", {}),
        ("http://127.0.0.1:8333", {}),
    ],
)
def test_store_elsewhere_wants_https(tmp_path, endpoint, found):
    assert ways(tmp_path, s3_endpoint=endpoint) == found
