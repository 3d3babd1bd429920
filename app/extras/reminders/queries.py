"""SQL of subscriptions: those that are due, and meals whose after-meal window ends soon."""

import uuid
from collections.abc import Collection, Sequence
from datetime import datetime, timedelta

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.stored.models import Meal
from app.people.models import Device, Participant, PushSubscription, Study

EATING = timedelta(minutes=10)  # however short the window is


def due(
    session: Session, now: datetime, limit: int
) -> Sequence[tuple[PushSubscription, list[str]]]:
    """Return locked subscriptions whose next reminder is due, with their study's times."""
    query = (
        _of_phones()
        .where(PushSubscription.next_at <= now)
        .order_by(PushSubscription.next_at)
        .limit(limit)
    )
    rows = session.execute(query.with_for_update(of=PushSubscription, skip_locked=True))
    return [(row.PushSubscription, row.reminder_times or []) for row in rows]


def unscheduled(session: Session, limit: int) -> Sequence[tuple[PushSubscription, list[str]]]:
    """Return locked subscriptions that follow their study's times and have not been scheduled since these changed."""
    has_times = Study.reminder_times.is_not(None)
    query = _of_phones().where(
        PushSubscription.next_at.is_(None), PushSubscription.times.is_(None), has_times
    )
    rows = session.execute(
        query.limit(limit).with_for_update(of=PushSubscription, skip_locked=True)
    )
    return [(row.PushSubscription, row.reminder_times or []) for row in rows]


def windows_ending(
    session: Session, now: datetime, before: datetime, limit: int
) -> Sequence[tuple[PushSubscription, datetime]]:
    """Return locked subscriptions with the end of an after-meal window until `before` that has no pair yet."""
    query = (
        sa.select(PushSubscription, Meal.after_due_at)
        .join(Meal, Meal.device_id == PushSubscription.device_id)
        .join(Device, Device.id == PushSubscription.device_id)
        .where(
            PushSubscription.after_meal,
            Device.revoked_at.is_(None),
            Meal.after_status.is_(None),
            Meal.after_due_at.between(now, before),
            Meal.captured_at <= now - EATING,
            sa.or_(
                PushSubscription.after_reminded_at.is_(None),
                PushSubscription.after_reminded_at < Meal.after_due_at,
            ),
        )
        .order_by(Meal.after_due_at)
        .limit(limit)
    )
    rows = session.execute(query.with_for_update(of=PushSubscription, skip_locked=True))
    return [(row.PushSubscription, row.after_due_at) for row in rows]


def of_participants(
    session: Session, study_id: uuid.UUID, codes: Collection[str]
) -> Sequence[tuple[PushSubscription, str]]:
    """Return locked subscriptions of a study's participants, with the participant's code."""
    query = (
        _of_phones()
        .add_columns(Participant.code)
        .where(Participant.study_id == study_id, Participant.code.in_(codes))
        .order_by(Participant.code, PushSubscription.device_id)
    )
    rows = session.execute(query.with_for_update(of=PushSubscription))
    return [(row.PushSubscription, row.code) for row in rows]


def remove_subscription(
    session: Session, device_id: uuid.UUID, endpoint: str | None = None
) -> bool:
    """Remove a phone's subscription, if it still has this endpoint. Returns whether there was one."""
    query = sa.delete(PushSubscription).where(PushSubscription.device_id == device_id)
    if endpoint is not None:
        query = query.where(PushSubscription.endpoint == endpoint)
    return session.execute(query.returning(PushSubscription.device_id)).first() is not None


def move_back(
    session: Session, moved: PushSubscription, column: str, before: datetime | None
) -> None:
    """Give a column of a subscription its former value, if it still has the one that it was moved on to."""
    is_unchanged = getattr(PushSubscription, column).is_not_distinct_from(getattr(moved, column))
    of_phone = PushSubscription.device_id == moved.device_id
    session.execute(
        sa.update(PushSubscription).where(of_phone, is_unchanged).values({column: before})
    )


def lock_device(session: Session, device_id: uuid.UUID) -> None:
    """Lock a phone until commit: of two first subscriptions at once the second waits, and then changes the first."""
    session.execute(
        sa.select(Device.id).where(Device.id == device_id).with_for_update(key_share=True)
    )


def remove_same_browser(session: Session, device_id: uuid.UUID, endpoint: str, auth: str) -> None:
    """Remove other devices' subscriptions of a browser: the former person's, whose sign-out may not have arrived."""
    # its secrets
    of_browser = sa.and_(PushSubscription.endpoint == endpoint, PushSubscription.auth == auth)
    session.execute(
        sa.delete(PushSubscription).where(of_browser, PushSubscription.device_id != device_id)
    )


def _of_phones() -> sa.Select[PushSubscription, list[str] | None]:
    return (
        sa.select(PushSubscription, Study.reminder_times)
        .join(Device, Device.id == PushSubscription.device_id)
        .join(Participant, Participant.id == Device.participant_id)
        .join(Study, Study.id == Participant.study_id)
        .where(Device.revoked_at.is_(None), Participant.withdrawn_at.is_(None))
    )
