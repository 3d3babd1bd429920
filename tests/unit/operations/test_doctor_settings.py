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
    ("query", "level"),
    [
        ("", "bad"),
        ("?sslmode=disable", "bad"),
        ("?sslmode=require", "bad"),  # encrypted, and to whoever answers
        ("?sslmode=verify-ca&sslrootcert=ca.pem", "ok"),
        ("?sslmode=verify-full&sslrootcert=system", "ok"),
    ],
)
@pytest.mark.parametrize("host", ["db.example.org", "10.0.0.7"])
def test_database_elsewhere_wants_tls_that_looks_at_the_certificate(tmp_path, host, query, level):
    url = f"postgresql://tada:secret@{host}/tada{query}"
    assert ways(tmp_path, database_url=url) == {"way to the database": level}


@pytest.mark.parametrize("url", ["postgresql:///tada?host=db.example.org", "postgresql://tada@/tada?host=10.0.0.7"])
def test_host_may_stand_in_the_query(tmp_path, url):
    assert ways(tmp_path, database_url=url) == {"way to the database": "bad"}


def test_sslmode_may_stand_in_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("PGSSLMODE", "verify-full")
    assert ways(tmp_path, database_url="postgresql://tada@db.example.org/tada") == {"way to the database": "ok"}


def test_host_of_one_word_may_be_a_container_next_door_or_another_machine(tmp_path):
    assert ways(tmp_path, database_url="postgresql://tada@postgres/tada") == {"way to the database": "note"}


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", ""])
def test_database_of_this_machine_needs_none(tmp_path, host):
    assert ways(tmp_path, database_url=f"postgresql://tada@{host}/tada") == {}
    assert ways(tmp_path, database_url="postgresql:///tada?host=/run/postgresql") == {}


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
