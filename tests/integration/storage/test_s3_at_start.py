"""A server or a worker that is set to a store which refuses it ends in a sentence; one that is away stops nobody."""

import pytest
from pydantic import SecretStr
from structlog.testing import capture_logs

from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.jobs.supervisor import settings_environment
from app.operations.explain_errors import check_stores
from app.storage.s3 import S3BlobStore
from tests.support.s3_places import s3_settings


@pytest.fixture
def settings(s3_server, tmp_path):
    return Settings(data_dir=tmp_path / "data", **s3_settings(s3_server))


def other(settings, **changes):
    return Settings(**settings.model_dump() | changes)


REFUSED = [
    ({"s3_secret_access_key": SecretStr("w" * 40)}, "TADA_BLOB_URL", "refuses our key"),
    ({"s3_access_key_id": "nobody"}, "TADA_BLOB_URL", "refuses our key"),
    ({"blob_url": "s3://nobodys-bucket"}, "TADA_BLOB_URL", "the bucket is not there"),
    ({"erasure_url": "s3://nobodys-bucket"}, "TADA_ERASURE_URL", "the bucket is not there"),
]


def test_store_that_refuses_us_ends_the_start_and_one_that_can_be_used_or_is_away_does_not(settings):
    check_stores(settings)
    check_stores(other(settings, s3_endpoint="http://127.0.0.1:9"))
    for changes, variable, words in REFUSED:
        with pytest.raises(InvalidInputError, match=words) as caught:
            check_stores(other(settings, **changes))
        assert caught.value.code == "settings_invalid"
        assert variable in caught.value.message


def test_worker_beside_the_server_gets_the_secret_and_a_ledger_beside_the_blobs(settings, monkeypatch):
    for name, value in settings_environment(settings).items():
        monkeypatch.setenv(name, value)
    again = Settings()
    assert again.s3_secret_access_key == settings.s3_secret_access_key
    assert again.resolved_erasure_url == f"{settings.blob_url}/.erasures"


def test_versions_are_a_fault_of_the_photographs_bucket_and_none_of_the_ledgers(settings, s3_server, monkeypatch):
    """docs/storage.md advises them for the ledger, which names nobody and is to stay."""
    s3_server.make_bucket("ledger-alone")
    apart = other(settings, erasure_url="s3://ledger-alone")
    check = S3BlobStore.check

    def check_with_versions(store, bucket):
        check(store)
        store.keeps_versions = str(store).startswith(bucket)

    def told(bucket):
        with monkeypatch.context() as patch, capture_logs() as logs:
            patch.setattr(S3BlobStore, "check", lambda store: check_with_versions(store, bucket))
            check_stores(apart)
        return [line["variable"] for line in logs if line["event"] == "store_keeps_versions"]

    assert told(settings.resolved_blob_url) == ["TADA_BLOB_URL"]
    assert told("s3://ledger-alone") == []
