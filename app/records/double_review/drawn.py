"""Which items two reviewers decide, as a condition of their records.

An item is drawn by the last 32 bits of its random id: if they are in an interval that begins where
the seed says, and is as long as the share of the item's stratum. So a choice needs no table, and a
greater share keeps what a smaller one drew.
"""

import hashlib
import uuid

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import Condition
from app.foods.models import Food
from app.meals.stored.decision_models import ReviewDecision
from app.meals.stored.record_models import EffectiveRecord
from app.people.double_review import DoubleReview
from app.people.models import Study
from app.records.page_queries import needs_look

PLACES = 2**32
DIGITS = 8  # hexadecimal, of a place


def protocol_of(study: Study) -> DoubleReview | None:
    """Return the study's protocol of double review; None: no item is decided twice."""
    fields = study.double_review
    return DoubleReview.model_validate(fields) if fields is not None else None


def is_blind(study: Study) -> Condition:
    """The record's item is drawn, or was when somebody decided it, and is not settled."""
    protocol = protocol_of(study)
    if protocol is None:
        return sa.false()
    needed = sa.and_(*needs_look(EffectiveRecord))
    is_seen = EffectiveRecord.origin != sa.literal_column("'declared'")
    is_settled = decisions(ReviewDecision.settled_at.is_not(None)).exists()
    is_chosen = sa.or_(_is_drawn(protocol), decisions().exists())
    return sa.and_(needed, is_seen, is_chosen, ~is_settled)


def blind_items_of(session: Session, study: Study, meal_id: uuid.UUID) -> set[uuid.UUID]:
    """Return the meal's items that two decide and that are not settled."""
    record = EffectiveRecord
    query = sa.select(record.item_id).where(record.meal_id == meal_id, is_blind(study))
    return set(session.scalars(query))


def decisions(*conditions: Condition) -> sa.Select[uuid.UUID]:
    """Select the decisions about a record's item, without those undone."""
    return sa.select(ReviewDecision.id).where(
        ReviewDecision.item_id == EffectiveRecord.item_id,
        ReviewDecision.undone_at.is_(None),
        *conditions,
    )


def _is_drawn(protocol: DoubleReview) -> Condition:
    start = int(hashlib.sha256(str(protocol.seed).encode()).hexdigest()[:DIGITS], 16)
    rest = _is_within(start, protocol.share)
    strata = []
    for stratum in protocol.strata:
        belongs: Condition = EffectiveRecord.doubt >= stratum.min_doubt
        if stratum.food_group is not None:
            of_group = sa.select(Food.id).where(Food.food_group == stratum.food_group)
            belongs = sa.and_(belongs, EffectiveRecord.food_id.in_(of_group))
        strata.append((belongs, _is_within(start, stratum.share)))
    return sa.case(*strata, else_=rest) if strata else rest


def _is_within(start: int, share: float) -> Condition:
    """The record's place is in the interval of this length from the start; behind the last place is the first."""
    length = round(share * PLACES)
    if length in (0, PLACES):
        return sa.true() if length else sa.false()
    text = sa.cast(EffectiveRecord.item_id, sa.String)
    place = sa.func.substr(text, sa.func.length(text) - DIGITS + 1)  # SQLite keeps no dashes
    first, last = f"{start:08x}", f"{(start + length - 1) % PLACES:08x}"
    is_whole = first <= last
    return place.between(first, last) if is_whole else sa.or_(place >= first, place <= last)
