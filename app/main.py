"""The HTTP composition root: settings in, app out. `create_app(settings)` opens nothing; its lifespan does."""

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

import anyio
from fastapi import Depends, FastAPI

import app.tables  # noqa: F401  # defines every table
from app import __version__
from app.capture.files import PATH as CAPTURE
from app.capture.files import CaptureFiles
from app.children.api_children import ApiChildren
from app.core.errors import NotFoundError
from app.core.process_life import at_stop_signal
from app.core.settings import Settings
from app.dashboard import guide
from app.dashboard import routes as dashboard
from app.dashboard.answers import DASHBOARD_PATHS, DashboardAnswers
from app.dashboard.templates import DashboardFiles
from app.db.session import open_database
from app.diary import api as diary
from app.diary.references import api as references
from app.exports import api as exports
from app.exports import data_dictionary_api as data_dictionary
from app.exports.export_places import ExportPlaces
from app.exports.lists import changes_api as changes
from app.exports.lists import days_api as days
from app.exports.lists import meals_api as meal_lists
from app.exports.lists import participants_api as study_participants
from app.exports.lists import photographs_api as study_photographs
from app.exports.lists import records_api as records
from app.exports.queries import take_back_places as take_back_exports
from app.exports.releases import api as releases
from app.exports.releases.queries import take_back_places as take_back_releases
from app.extras.fhir import api as fhir
from app.extras.reminders import api as reminders
from app.extras.sandbox import answers as sandbox
from app.foods import api as foods
from app.foods import reference_intakes_api as reference_intakes
from app.foods import study_densities_api as study_densities
from app.foods.edits import api as food_edits
from app.http.answers import AroundPath, Edge
from app.http.problems import install_problem_handlers
from app.http.rate_limit import CallLimits, EnrolmentLimit
from app.http.request_log import RequestLog
from app.http.state import ApiState
from app.jobs.queue import JobQueue
from app.meals.stored.receive_photo import PhotoIntake
from app.meals.upload import api as upload
from app.meals.upload import checks_api as checks
from app.meals.upload import packaged_api as packaged_foods
from app.meals.upload import partial_uploads_api as partial_uploads
from app.meals.upload import read_api as meals
from app.meals.upload import server_api as server
from app.meals.upload.after_meal import SubmitAfterPair
from app.meals.upload.declare_meal import DeclareMeal
from app.meals.upload.partial_uploads import PartialUploads
from app.meals.upload.read_api import MealWaiter
from app.meals.upload.server_api import FEATURES
from app.meals.upload.submit_meal import SubmitMeal
from app.metrics.instruments import register_build
from app.openapi import openapi_document
from app.operations import health_api as health
from app.operations.figures import DeploymentFigures
from app.operations.prepare import prepare_patiently
from app.operations.prepare_apart import prepare_apart
from app.people import calibrations_api as calibrations
from app.people import devices_api as devices
from app.people import participants_api as participants
from app.people import studies_api as studies
from app.people.access import audit_api as audit
from app.people.access import staff_api as staff
from app.people.access.access_rules import RULES, authorise
from app.people.access.last_use import LastUse
from app.people.access.passwords import Passwords
from app.people.access.secret_box import open_secret_box
from app.people.access.sign_in import SignInLimits
from app.people.access.web_origins import REQUEST_HEADERS, WEB_PATHS, WebOrigins
from app.people.location_policy import FilesWithPlaces
from app.privacy import me_api as me_privacy
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import ErasureLedger
from app.records import serve_photo as photographs
from app.records.double_review import api as double_review
from app.records.remeasurements import api as remeasurements
from app.records.review import api as review
from app.records.review.meal_events import MealEvents
from app.storage.opening import open_blob_store
from app.vessels import api as study_vessels
from app.webhooks import api as webhooks

DESCRIPTION = """
Image-based dietary assessment. A phone sends a meal as two photographs, from the left and from the right (or as one
to eight), with a printed checkerboard beside the plate; the server measures each food's volume, turns it into grams
and nutrients, and serves records. Times are RFC 3339 with offset; units stand in the names; errors are RFC 9457
problem documents with a stable `code`.
"""
EXTRAS = (fhir.install, reminders.install, sandbox.install)


@asynccontextmanager
async def open_parts(settings: Settings) -> AsyncIterator[ApiState]:
    """Open the parts that the endpoints of one process share; close them at its end."""
    register_build("api")
    box = open_secret_box(settings)
    database = open_database(settings)
    blobs = open_blob_store(settings.resolved_blob_url, settings)
    try:
        await anyio.to_thread.run_sync(
            lambda: prepare_patiently(database, settings, first=prepare_apart)
        )
    except BaseException:
        database.dispose()
        raise
    queue = JobQueue()
    waiter = MealWaiter(database)
    last_use = LastUse(database)
    children = ApiChildren(settings)
    photo_intake = PhotoIntake(database, blobs, settings, children)
    try:
        children.start_soon()
        yield ApiState(
            settings,
            database,
            blobs,
            parts=(
                queue,
                SubmitMeal(database, photo_intake, queue, box),
                PartialUploads(blobs.partial_folder()),
                SubmitAfterPair(database, photo_intake, queue, box),
                MealEvents(database, queue),
                DeclareMeal(database, box),
                waiter,
                box,
                children,
                Eraser(
                    database,
                    box,
                    ErasureLedger(open_blob_store(settings.resolved_erasure_url, settings), box),
                ),
                Passwords(),
                ExportPlaces(),
                last_use,
                DeploymentFigures(database, blobs, settings),
                FilesWithPlaces((take_back_exports, take_back_releases)),
                CallLimits(settings),
                EnrolmentLimit(settings.enrolment_attempts_per_minute),
                SignInLimits(database, box, settings.sign_in_attempts_per_minute),
            ),
        )
    finally:
        await anyio.to_thread.run_sync(children.close)
        await waiter.close()
        await anyio.to_thread.run_sync(last_use.close)
        database.dispose()


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """From the app's settings, as they are when it starts, to the parts that its endpoints ask for."""
    async with open_parts(app.state.settings) as app.state.api:
        with at_stop_signal(app.state.api.part(MealWaiter).release):
            yield


def create_app(settings: Settings, extras: Sequence[Callable[[FastAPI], None]] = EXTRAS) -> FastAPI:
    """The app of one process."""
    app = FastAPI(
        title="tada-server",
        version=__version__,
        description=DESCRIPTION,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        lifespan=lifespan,
        dependencies=[Depends(authorise)],
        docs_url=None,  # FastAPI's load their scripts from another host
        redoc_url=None,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.settings = settings
    # what extras may add to
    app.state.rules = dict(RULES)
    app.state.features = list(FEATURES)
    app.state.request_headers = list(REQUEST_HEADERS)
    app.state.on_metadata = None
    install_problem_handlers(app)
    app.exception_handler(NotFoundError)(me_privacy.on_not_found)
    app.mount("/dashboard/static", DashboardFiles())
    app.mount(CAPTURE, CaptureFiles())
    app.mount(guide.PATH, guide.GuideFiles())
    app.add_route(guide.REFERENCE_PATH, guide.api_reference, include_in_schema=False)
    for resource in (
        meal_lists,
        upload,
        meals,
        partial_uploads,
        photographs,
        checks,
        calibrations,
        me_privacy,
        audit,
        records,
        data_dictionary,
        study_photographs,
        study_participants,
        changes,
        exports,
        releases,
        remeasurements,
        review,
        double_review,
        days,
        diary,
        references,
        foods,
        food_edits,
        packaged_foods,
        reference_intakes,
        staff,
        studies,
        participants,
        devices,
        study_densities,
        study_vessels,
        webhooks,
        server,
        health,
        dashboard,
    ):
        app.include_router(resource.router)
    app.openapi = lambda: openapi_document(app)  # type: ignore[method-assign]  # FastAPI's own way to extend it
    app.add_middleware(Edge, calls=app.state.rules)
    app.add_middleware(AroundPath, pattern=WEB_PATHS, middleware=WebOrigins)
    for install in extras:
        install(app)
    app.add_middleware(RequestLog)
    app.add_middleware(AroundPath, pattern=DASHBOARD_PATHS, middleware=DashboardAnswers)
    return app
