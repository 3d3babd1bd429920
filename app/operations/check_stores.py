"""Before a process serves or works: do the stores take us as we are set? One that is away for a while stops nobody."""

import structlog

from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.storage.blob_store import BlobStore, StoreRefusesError
from app.storage.opening import open_blob_store

log = structlog.get_logger()


def check_stores(settings: Settings) -> None:
    """Raises InvalidInputError, `settings_invalid`, for a wrong key, a bucket that is not there and the like."""
    blobs = open_blob_store(settings.resolved_blob_url, settings)
    _check("TADA_BLOB_URL", blobs)
    _check("TADA_ERASURE_URL", open_blob_store(settings.resolved_erasure_url, settings))
    if blobs.keeps_versions:  # the ledger may: it names nobody, and is to stay
        log.error(
            "store_keeps_versions", variable="TADA_BLOB_URL", detail="What is erased stays in it: docs/storage.md."
        )


def _check(variable: str, store: BlobStore) -> None:
    try:
        store.check()
        next(store.keys("nobody/"), None)  # a key that may write and not list deletes no orphan
    except StoreRefusesError as error:
        raise InvalidInputError(f"{variable}, {error.filename}: {error.strerror}.", code="settings_invalid") from None
    except OSError as error:
        log.warning("store_not_usable", variable=variable, reason=error.strerror)
