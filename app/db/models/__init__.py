"""The tables, a file a part; importing this package defines them all (Alembic and the tests read `Base.metadata`)."""

from app.db.models.base import Base, UtcDateTime
from app.db.models.calibration import CameraCalibration
from app.db.models.diary import DayEvent, DayMark, DaySum, DiaryDay, StudyDayMark, StudyDaySum
from app.db.models.export import Export
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
from app.db.models.identification import IndexEntry, ItemIdentification
from app.db.models.job import Job, WorkerLease
from app.db.models.meal import Meal, MealImage
from app.db.models.people import AccessToken, Device, Enrolment, Participant, Staff, Study, StudyMember
from app.db.models.privacy import AuditEvent, BlobDeletion, ErasureReceipt, SpentCode, Tombstone
from app.db.models.record import (
    EffectiveRecord,
    Item,
    ItemCandidate,
    ItemFood,
    ItemMeasure,
    Leftover,
    Recompute,
    Run,
    RunArtefact,
)
from app.db.models.release import Release, ReleaseChange, ReleaseFile
from app.db.models.review import MealEvent
from app.db.models.spent_key import SpentKey
from app.db.models.vessel import StudyVessel, StudyVesselVersion
from app.db.models.webhook import Webhook, WebhookDelivery

__all__ = [
    "AccessToken",
    "AuditEvent",
    "Base",
    "BlobDeletion",
    "CameraCalibration",
    "Component",
    "DayEvent",
    "DayMark",
    "DaySum",
    "Device",
    "DiaryDay",
    "EffectiveRecord",
    "Enrolment",
    "ErasureReceipt",
    "Export",
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
    "IndexEntry",
    "Item",
    "ItemCandidate",
    "ItemFood",
    "ItemIdentification",
    "ItemMeasure",
    "Job",
    "Leftover",
    "Meal",
    "MealEvent",
    "MealImage",
    "Participant",
    "Recompute",
    "Release",
    "ReleaseChange",
    "ReleaseFile",
    "Run",
    "RunArtefact",
    "SpentCode",
    "SpentKey",
    "Staff",
    "Study",
    "StudyDayMark",
    "StudyDaySum",
    "StudyDensity",
    "StudyMember",
    "StudyVessel",
    "StudyVesselVersion",
    "Tombstone",
    "UtcDateTime",
    "Webhook",
    "WebhookDelivery",
    "WorkerLease",
]
