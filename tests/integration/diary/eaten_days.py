"""Days with known amounts, written straight into the database: what is summed over them does not depend on vision."""

import uuid
from datetime import UTC, date, datetime, time, timedelta

import sqlalchemy as sa

from app.foods.models import Food
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.models import Device, Participant, Study


def participant_of(session, code, study="pilot"):
    return session.scalars(
        sa.select(Participant).join(Study).where(Participant.code == code, Study.code == study)
    ).one()


def set_profile(state, code="P001", study="pilot", *, starts_on=None, **profile):
    with state.database.write() as session:
        participant = participant_of(session, code, study)
        participant.profile, participant.starts_on = profile or None, starts_on


def close(phone, *days, **body):
    """Have a phone close days."""
    for day in days:
        answer = phone.put(f"/v1/me/days/{day}", json={"status": "closed"} | body, headers={"If-Match": "*"})
        assert answer.status_code == 200


def eaten_item(grams=100.0, food=None, **columns):
    """An effective record's columns: grams that were eaten (None: not known), and what else is told."""
    return {"consumed_g": grams, "consumed_low_g": grams and 0.9 * grams, "consumed_high_g": grams and 1.1 * grams,
            "food": food, "status": "confirmed"} | columns  # fmt: skip


def add_meal(
    state,
    code,
    day,
    *items,
    study="pilot",
    hour=12,
    delay=timedelta(minutes=5),
    device_of=None,
    status="estimated",
    place=None,
):
    """A meal on a local day (UTC) with these items; its id."""
    day = date.fromisoformat(day) if isinstance(day, str) else day
    captured_at = datetime.combine(day, time(hour), UTC)
    with state.database.write() as session:
        participant = participant_of(session, code, study)
        device = session.scalars(
            sa.select(Device).where(Device.participant_id == (device_of or participant.id))
        ).first()
        meal = Meal(
            id=uuid.uuid4(),
            client_id=uuid.uuid4(),
            study_id=participant.study_id,
            participant_id=participant.id,
            device_id=device.id,
            captured_at=captured_at,
            utc_offset_minutes=0,
            time_zone="UTC",
            local_date=day,
            details={"hints": []} | ({"location": place} if place is not None else {}),
            status=status,
            received_at=captured_at + delay,
        )
        session.add(meal)
        session.flush()
        for position, columns in enumerate(items):
            _add_record(session, meal, position, dict(columns))
        return meal.client_id


def _add_record(session, meal, position, columns):
    food = columns.pop("food")
    origin = columns.pop("origin", "declared")
    item = Item(id=uuid.uuid4(), meal_id=meal.id, origin=origin, position=position, rings=[], relative_sd={}, flags=[])
    session.add(item)
    session.flush()
    food_id = session.scalars(sa.select(Food.id).where(Food.key == food)).first() if food else None
    session.add(
        EffectiveRecord(
            item_id=item.id,
            meal_id=meal.id,
            study_id=meal.study_id,
            participant_id=meal.participant_id,
            captured_at=meal.captured_at,
            local_date=meal.local_date,
            food_id=food_id,
            origin=origin,
            flags=[],
            details={"rings": None, "served": None, "left": [], "open_probes": []},
            change_seq=1,
            **columns,
        )
    )
