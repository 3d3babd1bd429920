"""SQL of spent keys: who deletes an orphan and who comes to name it agree on which of the two happens.

Both lock the key until they commit: who names it shared, who deletes it alone. So one is wholly before the other. The
one who names it is first: the deleter sees the row, and leaves the blob. The deleter is first: the key is spent, which
the other sees. SQLite needs no locks: it has one writer at a time.
"""

import hashlib
from collections.abc import Collection
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.spent_key_models import SpentKey


def spent_among(session: Session, keys: Collection[str]) -> set[str]:
    """Those of the keys that are never to be used again. Some hundreds at a time."""
    of_digests = {_digest(key): key for key in keys}
    if not of_digests:
        return set()
    query = sa.select(SpentKey.digest).where(SpentKey.digest.in_(of_digests))
    return {of_digests[digest] for digest in session.scalars(query)}


def hold(session: Session, keys: Collection[str]) -> None:
    """Until this transaction ends nobody spends these keys; ask for `spent_among` after it."""
    if keys and session.get_bind().dialect.name == "postgresql":
        locks = (sa.func.pg_advisory_xact_lock_shared(number) for number in sorted(map(_number, keys)))
        session.execute(sa.select(*locks))


def hold_alone(session: Session, keys: Collection[str]) -> set[str]:
    """Those of the keys that nobody is just about to name, or to spend; until this transaction ends it stays so.

    Some hundreds at a time. It waits for nobody, so it is in no deadlock with those who hold and wait.
    """
    if not keys or session.get_bind().dialect.name != "postgresql":
        return set(keys)
    ordered = sorted(keys)
    locks = (sa.func.pg_try_advisory_xact_lock(_number(key)) for key in ordered)
    got = session.execute(sa.select(*locks)).one()
    return {key for key, is_ours in zip(ordered, got, strict=True) if is_ours}


def spend(session: Session, keys: Collection[str], now: datetime) -> None:
    """No row may name the keys any more. The same again is harmless."""
    for key in set(keys) - spent_among(session, keys):
        session.add(SpentKey(digest=_digest(key), spent_at=now))


def _digest(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()


def _number(key: str) -> int:
    """Of its lock: 64 bits of its digest, signed. Two keys of one number wait for each other, no more."""
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], signed=True)
