"""Stores on a test's own prefix of an S3 server: no test sees another's objects."""

import uuid

from pydantic import SecretStr

from app.storage.s3 import PATIENCE, Patience, S3BlobStore, S3Place
from tests.support.s3_server import REGION, S3Server

BUCKET = "tests"
IMPATIENT = Patience(connect_seconds=1.0, answer_seconds=2.0, retry_seconds=2.0, tries=2, turn_seconds=2.0)


def s3_place(server: S3Server, **changes) -> S3Place:
    """A prefix of its own in the bucket `tests`; changes: other fields of S3Place."""
    server.make_bucket(BUCKET)
    fields = {
        "bucket": BUCKET,
        "prefix": uuid.uuid4().hex,
        "region": REGION,
        "endpoint": server.endpoint,
        "access_key_id": server.access_key_id,
        "secret_access_key": SecretStr(server.secret_access_key),
    }
    return S3Place(**fields | changes)


def s3_store(server: S3Server, staging, patience: Patience = PATIENCE, **changes) -> S3BlobStore:
    return S3BlobStore(s3_place(server, **changes), staging, patience)


def s3_settings(server: S3Server) -> dict[str, object]:
    """The settings of a deployment on a prefix of its own, as keywords of Settings."""
    server.make_bucket(BUCKET)
    return {
        "blob_url": f"s3://{BUCKET}/{uuid.uuid4().hex}",
        "s3_endpoint": server.endpoint,
        "s3_region": REGION,
        "s3_access_key_id": server.access_key_id,
        "s3_secret_access_key": SecretStr(server.secret_access_key),
    }
