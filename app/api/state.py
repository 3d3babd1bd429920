"""What the endpoints of one process share; app/main.py makes it, app/api/deps.py hands it out."""

from dataclasses import dataclass

import anyio

from app.api.call_limits import CallLimits
from app.api.rate_limit import RateLimit
from app.api.sign_in_limits import SignInLimits
from app.api.waiting import MealWaiter
from app.db.session import Database
from app.jobs.queue import JobQueue
from app.services.after_meal import SubmitAfterPair
from app.services.api_children import ApiChildren
from app.services.declare_meal import DeclareMeal
from app.services.erase import Eraser
from app.services.export_me import ExportPlaces
from app.services.figures import DeploymentFigures
from app.services.last_use import LastUse
from app.services.meal_events import MealEvents
from app.services.passwords import Passwords
from app.services.secret_box import SecretBox
from app.services.submit_meal import SubmitMeal
from app.settings import Settings
from app.storage.blob_store import BlobStore


@dataclass(frozen=True, slots=True)
class ApiState:
    """Parts made once a process."""

    settings: Settings
    database: Database
    blobs: BlobStore
    queue: JobQueue
    submit_meal: SubmitMeal
    after_pairs: SubmitAfterPair
    meal_events: MealEvents
    declare_meal: DeclareMeal
    waiter: MealWaiter
    upload_limiter: anyio.CapacityLimiter
    call_limits: CallLimits
    enrolment_limit: RateLimit
    secrets: SecretBox
    children: ApiChildren
    eraser: Eraser
    sign_in_limits: SignInLimits
    passwords: Passwords
    export_places: ExportPlaces
    last_use: LastUse
    figures: DeploymentFigures
