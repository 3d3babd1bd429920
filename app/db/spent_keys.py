"""SQL of spent keys: order the deletion of an orphan blob and a transaction that names its key.

Both lock the key until they commit: a naming transaction shared, a deleting one exclusively, so one
comes entirely before the other. If naming comes first, the deleter sees the row and keeps the blob.
If deletion comes first, the other sees that the key is spent. SQLite needs no locks, since it has
one writer at a time.
"""

import hashlib
from collections.abc import Collection
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, Session, mapped_column

from app.db.base import Base
from app.db.columns import Str64


class SpentKey(Base):
    """The key of a blob that is or will be deleted as an orphan: no row may name it any more.

    Committed before the deletion and never removed, since the deleting process may be suspended for
    days in between. digest: SHA-256 of the key, which reveals nothing about an erased meal.
    """

    __tablename__ = "spent_key"

    digest: Mapped[Str64] = mapped_column(primary_key=True)
    spent_at: Mapped[datetime]


def spent_among(session: Session, keys: Collection[str]) -> set[str]:
    """Return those of the keys that must not be used again. For some hundreds at a time."""
    key_of_digest = {_digest(key): key for key in keys}
    if not key_of_digest:
        return set()
    query = sa.select(SpentKey.digest).where(SpentKey.digest.in_(key_of_digest))
    return {key_of_digest[digest] for digest in session.scalars(query)}


def hold(session: Session, keys: Collection[str]) -> None:
    """Prevent these keys from being spent until this transaction ends; call `spent_among` afterwards."""
    if keys and session.get_bind().dialect.name == "postgresql":
        locks = (
            sa.func.pg_advisory_xact_lock_shared(number) for number in sorted(map(_number, keys))
        )
        session.execute(sa.select(*locks))


def hold_alone(session: Session, keys: Collection[str]) -> set[str]:
    """Lock keys exclusively until this transaction ends, and return those that no other transaction has locked.

    For some hundreds at a time. It does not wait, so it cannot deadlock with `hold`, which does.
    """
    if not keys or session.get_bind().dialect.name != "postgresql":
        return set(keys)
    ordered = sorted(keys)
    locks = (sa.func.pg_try_advisory_xact_lock(_number(key)) for key in ordered)
    locked = session.execute(sa.select(*locks)).one()
    return {key for key, is_locked in zip(ordered, locked, strict=True) if is_locked}


def spend(session: Session, keys: Collection[str], now: datetime) -> None:
    """Record that no row may name the keys any more. Repeating it is harmless."""
    for key in set(keys) - spent_among(session, keys):
        session.add(SpentKey(digest=_digest(key), spent_at=now))


def _digest(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()


def _number(key: str) -> int:
    """Return the number of its lock: 64 bits of its digest, signed.

    A collision only makes two keys share a lock.
    """
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], signed=True)
