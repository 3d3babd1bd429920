"""The tables, a file a part; importing this package defines them all (Alembic and the tests read `Base.metadata`)."""

from app.db.models.base import Base, UtcDateTime
from app.db.models.food import (
    Component,
    Food,
    FoodActivation,
    FoodChange,
    FoodDensity,
    FoodIngredient,
    FoodNutrient,
    FoodPortion,
    FoodRelease,
    StudyDensity,
)
from app.db.models.food_search import FoodCode, FoodPosting, FoodWord, FoodWordTrigram
from app.db.models.job import Job, WorkerLease
from app.db.models.meal import Meal, MealImage
from app.db.models.people import AccessToken, Device, Enrolment, Participant, Staff, Study
from app.db.models.record import EffectiveRecord, Item, ItemCandidate, ItemFood, Recompute, Run, RunArtefact

__all__ = [
    "AccessToken",
    "Base",
    "Component",
    "Device",
    "EffectiveRecord",
    "Enrolment",
    "Food",
    "FoodActivation",
    "FoodChange",
    "FoodCode",
    "FoodDensity",
    "FoodIngredient",
    "FoodNutrient",
    "FoodPortion",
    "FoodPosting",
    "FoodRelease",
    "FoodWord",
    "FoodWordTrigram",
    "Item",
    "ItemCandidate",
    "ItemFood",
    "Job",
    "Meal",
    "MealImage",
    "Participant",
    "Recompute",
    "Run",
    "RunArtefact",
    "Staff",
    "Study",
    "StudyDensity",
    "UtcDateTime",
    "WorkerLease",
]
