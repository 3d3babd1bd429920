"""Before a restore writes anything: the ledger of erasures must be that of then, and what it holds can be done again.

Else people who were erased after the backup was made would come back with it, or be found out only when the restored
deployment refuses to start.
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


def require_ledger(settings: Settings, remembered: ScratchKeys, *, other_ledger: bool) -> int:
    """Returns how many erasures the backup remembers and the ledger lacks: 0, unless other_ledger lets it be another.

    remembered: the erasures of the backup; they are seen afterwards if the ledger has them.
    Raises LedgerDiffersError, SecretKeyError for entries that are to be done again and were made under another key,
    InvalidInputError for one that is none, OSError.
    """
    store = open_blob_store(settings.resolved_erasure_url, settings)
    box, later = box_that_is_there(settings), 0
    ledger = ErasureLedger(store, box) if box is not None else None
    for kind in KINDS:
        for blob in store.keys(f"{kind}/"):
            if remembered.see(blob.key):
                continue
            later += 1
            if ledger is not None:
                _require_entry(ledger, blob.key)
    if later and ledger is None:
        raise _of_another_key()
    missing = remembered.count_unseen()
    if missing and not other_ledger:
        raise LedgerDiffersError(
            f"The ledger of erasures ({settings.resolved_erasure_url}) lacks {missing} erasures that the backup "
            "remembers, so it is not the ledger of then: whoever was erased after the backup would come back. Set "
            "TADA_ERASURE_URL to the ledger of then, or copy its entries here. If it is lost: --other-ledger. Nothing "
            "was restored."
        )
    return missing


def box_that_is_there(settings: Settings) -> SecretBox | None:
    """The deployment's key; None: it has none yet, and none is drawn. Raises SecretKeyError where one must be set."""
    if settings.is_embedded and settings.secret_key is None and not (settings.data_dir / KEY_FILE).exists():
        return None
    return open_secret_box(settings)


def _require_entry(ledger: ErasureLedger, key: str) -> None:
    """An erasure of after the backup can be read, so that it can be done again."""
    kind, _, digest = key.partition("/")
    try:
        ledger.read("meal" if kind == "meal" else "participant", digest)
    except SecretKeyError:
        raise _of_another_key() from None
    except (ValueError, KeyError, TypeError) as error:
        raise InvalidInputError(
            f"The ledger of erasures has an entry that is none: {key}. Nothing was restored.", code="ledger_broken"
        ) from error


def _of_another_key() -> SecretKeyError:
    return SecretKeyError(
        "The ledger of erasures has erasures of after the backup, made under another TADA_SECRET_KEY: nobody can tell "
        "whom they erased, and they would come back. Give the key of then. If it is lost, let TADA_ERASURE_URL lead to "
        "another place (--other-ledger), and erase them again. Nothing was restored."
    )
