"""What a store holds, seen from outside of the product: by its folder, or by the server's own listing."""

import os
import time
import uuid
from dataclasses import replace
from datetime import timedelta

import obstore

from app.core.settings import Settings
from app.storage.blob_store import LOCK_SUFFIX
from app.storage.local import STAGING, LocalBlobStore
from app.storage.opening import open_blob_store
from app.storage.s3 import S3BlobStore

TWO_DAYS = timedelta(days=2)
LEDGER = ".erasures/"  # where it stands when the blobs are in S3 (app/core/settings.py)


def stored_names(blobs) -> list[str]:
    """Of all that lies in the store, keys or not, and of what is staged; the ledger of erasures left out."""
    return sorted(_stored(blobs))


def store_bytes(blobs) -> bytes:
    """Names and contents of all that lies in the store, and of what is staged, in lower case."""
    return b"\n".join(name.encode() + b" " + content for name, content in _stored(blobs).items()).lower()


def _stored(blobs) -> dict[str, bytes]:
    if isinstance(blobs, LocalBlobStore):
        return _files(blobs._root)
    assert isinstance(blobs, S3BlobStore)
    found = {f"{STAGING}/{name}": content for name, content in _files(blobs.staging_folder()).items()}
    for page in obstore.list(blobs._store):
        for one in page:
            if not one["path"].startswith(LEDGER):
                found[one["path"]] = bytes(obstore.get(blobs._store, one["path"]).bytes())
    return found


def _files(folder) -> dict[str, bytes]:
    """But no lock of a folder of files in the making, which holds nothing."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.suffix != LOCK_SUFFIX)
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def make_old(blobs, keys=None) -> None:
    """These blobs, or all, as if they were sealed two days ago; what is put again from now on is young."""
    old = {blob.key for blob in blobs.keys()} if keys is None else set(keys)  # noqa: SIM118  # a store is no mapping
    if isinstance(blobs, LocalBlobStore):
        past = time.time() - TWO_DAYS.total_seconds()
        for key in old:
            os.utime(blobs._root / key, (past, past))
        return
    listed, put_file, put_bytes = blobs.keys, blobs.put_file, blobs.put_bytes  # S3 lets nobody set a time

    def keys_with_ages(prefix=""):
        for blob in listed(prefix):
            yield replace(blob, stored_at=blob.stored_at - TWO_DAYS) if blob.key in old else blob

    def put_file_young(key, source):
        put_file(key, source)
        old.discard(key)

    def put_bytes_young(key, content):
        put_bytes(key, content)
        old.discard(key)

    blobs.keys, blobs.put_file, blobs.put_bytes = keys_with_ages, put_file_young, put_bytes_young


def damage(blobs, key, content) -> None:
    """Other bytes in place of a blob, as a bad disk or a careless hand leaves them."""
    if isinstance(blobs, LocalBlobStore):
        path = blobs._root / key
        assert path.is_file()
        path.chmod(0o600)
        path.write_bytes(content)
    else:
        assert blobs.has(key)
        obstore.put(blobs._store, key, content)


def copy_of_store(blobs, settings: Settings, folder) -> str:
    """A copy of all blobs in a store of its own of the same sort: its URL."""
    url = f"file://{folder}"
    if isinstance(blobs, S3BlobStore):
        url = f"s3://{blobs._place.bucket}/{uuid.uuid4().hex}"
    copy = open_blob_store(url, settings)
    for blob in blobs.keys():  # noqa: SIM118
        copy.put_bytes(blob.key, blobs.read(blob.key))
    return url
