"""Open a blob store by its URL: `file:///var/lib/tada/blobs`, or `s3://bucket/prefix` with the TADA_S3_ settings."""

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.storage.blob_store import BlobStore
from app.storage.local import LocalBlobStore

if TYPE_CHECKING:
    from app.storage.s3 import S3Place

STAGING = "staging"  # a folder in data_dir for uploads to a remote store


def open_blob_store(url: str, settings: Settings) -> BlobStore:
    """Return the store of a URL, without network access.

    Raises InvalidInputError, `settings_invalid`.
    """
    parts = urlsplit(url)
    if parts.scheme == "file" and parts.path and not parts.netloc:
        return LocalBlobStore(Path(unquote(parts.path)))
    if parts.scheme == "s3":
        from app.storage.s3 import S3BlobStore  # noqa: PLC0415  # saves 5 MB in processes with a local store

        return S3BlobStore(s3_place(url, settings), settings.data_dir.absolute() / STAGING)
    raise _invalid(
        "TADA_BLOB_URL and TADA_ERASURE_URL are file:///an/absolute/path or s3://bucket/prefix."
    )


def s3_place(url: str, settings: Settings) -> "S3Place":
    """Parse s3://bucket/prefix and the settings.

    Raises InvalidInputError, which never quotes the URL.
    """
    from app.storage.s3 import S3Place  # noqa: PLC0415  # as above

    parts = urlsplit(url)
    if (
        "@" in parts.netloc
        or ":" in parts.netloc
        or parts.query
        or parts.fragment
        or not parts.netloc
    ):
        raise _invalid(
            "A store's URL is s3://bucket/prefix and nothing else: set keys in TADA_S3_ACCESS_KEY_ID and so on."
        )
    if (settings.s3_access_key_id is None) != (settings.s3_secret_access_key is None):
        raise _invalid(
            "TADA_S3_ACCESS_KEY_ID and TADA_S3_SECRET_ACCESS_KEY go together: set both or none."
        )
    endpoint = settings.s3_endpoint
    if endpoint is not None:
        endpoint_parts = urlsplit(endpoint)
        if (
            endpoint_parts.scheme not in ("http", "https")
            or not endpoint_parts.hostname
            or endpoint_parts.username
            or endpoint_parts.path.strip("/")
        ):
            raise _invalid(
                "TADA_S3_ENDPOINT must be like https://s3.example.org:9000: http or https, a host, no path."
            )
    return S3Place(
        bucket=parts.netloc,
        prefix=unquote(parts.path).strip("/"),
        region=settings.s3_region,
        endpoint=endpoint.rstrip("/") if endpoint is not None else None,
        access_key_id=settings.s3_access_key_id,
        secret_access_key=settings.s3_secret_access_key,
    )


def _invalid(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="settings_invalid")
