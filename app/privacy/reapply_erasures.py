"""After a restore: whatever the ledger knows as erased and the database has again is erased again, before serving.

Also what a crash left between the ledger and the transaction. A database in which all is done is seen by its
tombstones; only otherwise are the digests of all ids made and compared.
"""

import uuid
from collections.abc import Iterable
from datetime import datetime

import structlog

from app.people import privacy_queries as people_privacy
from app.people.tombstones import Deed, Kind, digest_of
from app.privacy import queries as privacy
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import DEEDS, KINDS, Erasure
from app.privacy.withdraw import carry_out_on_participant
from app.storage.blob_store import BlobStore

log = structlog.get_logger()


def reapply_erasures(eraser: Eraser, blobs: BlobStore, before: datetime | None = None) -> int:
    """Finish every erasure of the ledger, or those noted before a time. Returns how many had to be carried out.

    Raises SecretKeyError where the ledger was written under another key.
    """
    done = sum(_reapply(eraser, kind, before) for kind in KINDS)
    if done:
        log.warning("erasures_reapplied", count=done)
        BlobDeleter(eraser.database, blobs).delete_wanted()
    return done


def _reapply(eraser: Eraser, kind: Kind, before: datetime | None) -> int:
    noted = set(eraser.ledger.digests(kind, before))
    with eraser.database.read() as session:
        open_ones = noted - people_privacy.tombstones_among(session, kind, noted)
    if not open_ones:
        return 0
    erasures = {digest: eraser.ledger.read(kind, digest) for digest in sorted(open_ones)}
    done = 0
    for digest, thing_id in _find(eraser, kind, open_ones).items():
        erasure = erasures[digest]
        if kind == "meal":
            receipt = eraser.carry_out_on_meal(erasure, thing_id, None)
        else:
            receipt = carry_out_on_participant(eraser, erasure, thing_id, None)
        done += receipt is not None
    _settle(eraser, kind, erasures.values())
    return done


def _find(eraser: Eraser, kind: Kind, digests: set[str]) -> dict[str, uuid.UUID]:
    """Digest -> id of what is there and should not be; of several deeds on a person the weakest first."""
    found: dict[str, uuid.UUID] = {}
    with eraser.database.read() as session:
        list_ids = privacy.meal_ids if kind == "meal" else people_privacy.participant_ids
        deeds: tuple[Deed, ...] = ("erase",) if kind == "meal" else DEEDS
        for thing_id in list_ids(session):
            for deed in deeds:
                digest = digest_of(eraser.box, kind, deed, thing_id)
                if digest in digests:
                    found[digest] = thing_id
    return found


def _settle(eraser: Eraser, kind: Kind, erasures: Iterable[Erasure]) -> None:
    """Those whose rows are not there (a backup from before they came) need not be looked for at every start."""
    with eraser.database.write() as session:
        for erasure in erasures:
            people_privacy.add_tombstones(session, kind, [erasure.digest], erasure.at, study_id=None)
