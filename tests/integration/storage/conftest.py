"""Every test of the contract runs on files and on a real S3 server."""

import pytest

from app.storage.blob_store import BlobStore
from app.storage.local import LocalBlobStore
from tests.support.s3_places import s3_store


@pytest.fixture(params=["files", "s3"])
def store(request, tmp_path) -> BlobStore:
    if request.param == "files":
        return LocalBlobStore(tmp_path / "blobs")
    return s3_store(request.getfixturevalue("s3_server"), tmp_path / "staging")
