"""Check before a restore that the ledger of erasures is the original one and that its entries can be reapplied.

Otherwise people erased after the backup would come back with it, or the restored deployment would refuse to start.
"""

from app.core.errors import ConflictError, InvalidInputError
from app.core.settings import Settings
from app.db.scratch_keys import ScratchKeys
from app.people.access.secret_box import KEY_FILE, SecretBox, SecretKeyError, open_secret_box
from app.privacy.erasure_ledger import KINDS, ErasureLedger
from app.storage.opening import open_blob_store


class LedgerDiffersError(ConflictError):
    """The ledger of erasures is not the one that the backup's deployment wrote."""

    code = "ledger_differs"


def require_ledger(settings: Settings, recorded: ScratchKeys, *, other_ledger: bool) -> int:
    """Return how many erasures of the backup the ledger lacks: 0, unless other_ledger accepts a different one.

    recorded: the erasures of the backup; those in the ledger are marked as seen.
    Raises LedgerDiffersError, SecretKeyError for entries to reapply that were made with another key,
    InvalidInputError for an invalid entry, OSError.
    """
    store = open_blob_store(settings.resolved_erasure_url, settings)
    box, later = existing_box(settings), 0
    ledger = ErasureLedger(store, box) if box is not None else None
    for kind in KINDS:
        for blob in store.keys(f"{kind}/"):
            if recorded.see(blob.key):
                continue
            later += 1
            if ledger is not None:
                _require_entry(ledger, blob.key)
    if later and ledger is None:
        raise _other_key_error()
    missing = recorded.count_unseen()
    if missing and not other_ledger:
        raise LedgerDiffersError(
            f"The ledger of erasures ({settings.resolved_erasure_url}) lacks {missing} erasures that the backup "
            "records, so it is not the original ledger: whoever was erased after the backup would come back. Set "
            "TADA_ERASURE_URL to the original ledger, or copy its entries here. If it is lost: --other-ledger. Nothing "
            "was restored."
        )
    return missing


def existing_box(settings: Settings) -> SecretBox | None:
    """Return the deployment's key, or None if it has none yet. Raises SecretKeyError if one is required."""
    if settings.is_embedded and settings.secret_key is None and not (settings.data_dir / KEY_FILE).exists():
        return None
    return open_secret_box(settings)


def _require_entry(ledger: ErasureLedger, key: str) -> None:
    """Require that an erasure from after the backup can be read, so that it can be reapplied."""
    kind, _, digest = key.partition("/")
    try:
        ledger.read("meal" if kind == "meal" else "participant", digest)
    except SecretKeyError:
        raise _other_key_error() from None
    except (ValueError, KeyError, TypeError) as error:
        raise InvalidInputError(
            f"The ledger of erasures has an invalid entry: {key}. Nothing was restored.", code="ledger_broken"
        ) from error


def _other_key_error() -> SecretKeyError:
    return SecretKeyError(
        "The ledger has erasures from after the backup, made with another TADA_SECRET_KEY: they cannot be read, so the "
        "people they erased would come back. Set the original key. If it is lost, set TADA_ERASURE_URL to another "
        "place (--other-ledger), and erase them again. Nothing was restored."
    )
