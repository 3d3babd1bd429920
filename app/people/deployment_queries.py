"""SQL of the one row about the deployment."""

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.people.privacy_models import DEPLOYMENT, Deployment


def locked_deployment(session: Session) -> Deployment:
    """Return the row, locked until the transaction ends."""
    return session.get_one(Deployment, DEPLOYMENT, with_for_update=True, populate_existing=True)


def clock_doubted_seconds(session: Session) -> float:
    """Return how long the workers must still run until the clock is trusted; 0: it is trusted."""
    return session.get_one(Deployment, DEPLOYMENT).clock_doubted_seconds


def key_check(session: Session) -> str | None:
    """Return the digest by the secret key that the database was first used with; None: by none yet."""
    return session.scalar(sa.select(Deployment.key_check))


def keep_key_check(session: Session, check: str) -> None:
    """Keep the digest unless another process has kept one meanwhile."""
    deployment = locked_deployment(session)
    deployment.key_check = deployment.key_check or check
