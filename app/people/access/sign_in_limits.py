"""Limits of sign-in attempts by name and address, so that an attacker cannot lock out another person's name.

Attempts are counted in the database, so that several processes and hosts count together.
"""

import math
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.core.errors import RateLimitedError, UnauthenticatedError
from app.db.session import Database
from app.http.rate_limit import too_many_calls
from app.metrics import instruments
from app.people.access.secret_box import SecretBox
from app.people.access.staff import normal_name
from app.people.models import SignInAttempt

# attempts from one address, as a multiple of those of one name: a clinic is one address
ADDRESS_FACTOR = 3
NAME_FACTOR = 10  # attempts of one name from all addresses, as the same multiple
WINDOW = timedelta(minutes=1)
FAILURES_KEPT, SUCCESSES_KEPT = timedelta(hours=1), timedelta(days=90)
LOCK = 7_346_210_988  # of PostgreSQL, that attempts are counted one after the other: any number of our own


class SignInLimits:
    """per_minute: attempts of one name from one address.

    A name's limit over all addresses does not apply to addresses from which that person has signed in before, so a
    distributed attack keeps them out at new addresses only.
    """

    def __init__(self, database: Database, box: SecretBox, per_minute: int) -> None:
        self._database = database
        self._box = box
        self._per_minute = per_minute

    @contextmanager
    def trying(self, name: str, address: str) -> Iterator[None]:
        """Count an attempt and its outcome. Raises RateLimitedError."""
        attempt_id = uuid.uuid4()
        try:
            with self._database.write() as session:
                attempt = SignInAttempt(
                    id=attempt_id,
                    name_digest=self._box.digest("sign-in name", normal_name(name)),
                    address_digest=self._box.digest("sign-in address", address),
                    attempted_at=datetime.now(UTC),
                )
                self._require_room(session, attempt)
                session.add(attempt)
        except RateLimitedError:
            instruments.SIGN_INS.labels("limited").inc()
            raise
        try:
            yield
        except UnauthenticatedError:
            instruments.SIGN_INS.labels("failed").inc()
            raise
        instruments.SIGN_INS.labels("ok").inc()
        with self._database.write() as session:
            session.execute(
                sa.update(SignInAttempt)
                .where(SignInAttempt.id == attempt_id)
                .values(is_success=True)
            )

    def _require_room(self, session: Session, attempt: SignInAttempt) -> None:
        if session.get_bind().dialect.name == "postgresql":
            session.execute(sa.select(sa.func.pg_advisory_xact_lock(LOCK)))
        of_name = SignInAttempt.name_digest == attempt.name_digest
        of_address = SignInAttempt.address_digest == attempt.address_digest
        is_usual = session.scalar(
            sa.select(sa.exists().where(of_name, of_address, SignInAttempt.is_success))
        )
        limits = [
            (sa.and_(of_name, of_address), self._per_minute),
            (of_address, ADDRESS_FACTOR * self._per_minute),
        ]
        if not is_usual:
            limits.append((of_name, NAME_FACTOR * self._per_minute))
        for condition, most in limits:
            self._require_fewer(session, condition, most, attempt.attempted_at)

    def _require_fewer(
        self, session: Session, condition: sa.ColumnElement[bool], most: int, now: datetime
    ) -> None:
        """Raise RateLimitedError if the last minute has so many attempts."""
        query = sa.select(sa.func.count(), sa.func.min(SignInAttempt.attempted_at)).where(
            condition, SignInAttempt.attempted_at > now - WINDOW
        )
        count, first_at = session.execute(query).one()
        if count >= most:
            raise too_many_calls(math.ceil((first_at + WINDOW - now).total_seconds()), most)


def forget_attempts(database: Database) -> None:
    """Remove attempts that no longer count."""
    now = datetime.now(UTC)
    is_old = SignInAttempt.attempted_at < now - FAILURES_KEPT
    is_very_old = SignInAttempt.attempted_at < now - SUCCESSES_KEPT
    with database.write() as session:
        session.execute(
            sa.delete(SignInAttempt).where(
                sa.or_(is_very_old, sa.and_(is_old, sa.not_(SignInAttempt.is_success)))
            )
        )
