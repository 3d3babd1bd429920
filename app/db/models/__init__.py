"""The tables, a file a part; importing this package defines them all (Alembic and the tests read `Base.metadata`)."""

from app.db.models.base import Base, UtcDateTime
from app.db.models.food import Component, Food, FoodDensity, FoodNutrient, FoodRelease
from app.db.models.job import Job, WorkerLease
from app.db.models.meal import Meal, MealImage
from app.db.models.people import AccessToken, Device, Enrolment, Participant, Staff, Study
from app.db.models.record import EffectiveRecord, Item, ItemCandidate, Run, RunArtefact

__all__ = [
    "AccessToken",
    "Base",
    "Component",
    "Device",
    "EffectiveRecord",
    "Enrolment",
    "Food",
    "FoodDensity",
    "FoodNutrient",
    "FoodRelease",
    "Item",
    "ItemCandidate",
    "Job",
    "Meal",
    "MealImage",
    "Participant",
    "Run",
    "RunArtefact",
    "Staff",
    "Study",
    "UtcDateTime",
    "WorkerLease",
]
