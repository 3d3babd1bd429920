"""Check before a process starts that the stores accept its configuration; a temporary outage does not stop it."""

import structlog

from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.storage.blob_store import BlobStore, StoreRefusesError
from app.storage.opening import open_blob_store

log = structlog.get_logger()


def check_stores(settings: Settings) -> None:
    """Raise InvalidInputError, `settings_invalid`, for a wrong key, a missing bucket and the like."""
    blobs = open_blob_store(settings.resolved_blob_url, settings)
    _check("TADA_BLOB_URL", blobs)
    _check("TADA_ERASURE_URL", open_blob_store(settings.resolved_erasure_url, settings))
    if blobs.keeps_versions:  # the ledger may: it names nobody, and is kept
        log.error(
            "store_keeps_versions",
            variable="TADA_BLOB_URL",
            detail="Erased blobs remain in it: docs/storage.md.",
        )


def _check(variable: str, store: BlobStore) -> None:
    try:
        store.check()
        next(
            store.keys("nobody/"), None
        )  # orphans cannot be deleted with a key that may write but not list
    except StoreRefusesError as error:
        raise InvalidInputError(
            f"{variable}, {error.filename}: {error.strerror}.", code="settings_invalid"
        ) from None
    except OSError as error:
        log.warning("store_not_usable", variable=variable, reason=error.strerror)
