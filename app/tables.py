"""Every table: importing this module defines them all. Composition roots, Alembic and erasures do."""

import app.db.spent_keys
import app.diary.references.models
import app.exports.models
import app.exports.release_models
import app.foods.models
import app.foods.packaged.models
import app.foods.search.models
import app.meals.stored.decision_models
import app.meals.stored.event_models
import app.meals.stored.identification_models
import app.meals.stored.job_models
import app.meals.stored.models
import app.meals.stored.record_models
import app.outbox.models
import app.people.models
import app.people.privacy_models
import app.vessels.models
from app.db.base import Base

__all__ = ["METADATA"]

METADATA = Base.metadata
