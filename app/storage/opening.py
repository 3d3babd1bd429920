"""From a blob URL to a store: `open_blob_store("file:///var/lib/tada/blobs")`."""

from pathlib import Path
from urllib.parse import unquote, urlsplit

from app.errors import InvalidInputError
from app.storage.blob_store import BlobStore
from app.storage.local import LocalBlobStore


def open_blob_store(url: str) -> BlobStore:
    """The store that a URL names. Raises InvalidInputError with what is allowed."""
    parts = urlsplit(url)
    if parts.scheme == "file" and parts.path:
        return LocalBlobStore(Path(unquote(parts.path)))
    raise InvalidInputError(f"TADA_BLOB_URL is {url!r}; it must be file:///an/absolute/path.", code="settings_invalid")
