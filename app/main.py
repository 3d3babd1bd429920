"""The HTTP composition root: settings in, app out. `create_app(settings)` opens nothing; its lifespan does."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
from fastapi import Depends, FastAPI

from app import __version__
from app.api import (
    adequacy,
    after_meal,
    audit,
    calibrations,
    changes,
    checks,
    data_dictionary,
    days,
    declared,
    devices,
    enrolments,
    exports,
    food_edits,
    food_groups,
    foods,
    health,
    me,
    me_privacy,
    meal_jobs,
    meal_lists,
    meals,
    metrics,
    overview,
    participants,
    photographs,
    questions,
    receipts,
    records,
    reference_intakes,
    releases,
    review,
    review_queue,
    server,
    sessions,
    staff,
    studies,
    study_densities,
    study_members,
    study_photographs,
    study_vessels,
    summary,
    tokens,
    webhooks,
)
from app.api.access import authorise
from app.api.answers import ApiAnswers
from app.api.body_limit import BodyLimit
from app.api.call_limits import AddressLimit, CallLimits
from app.api.contract import openapi_document
from app.api.fhir import routes as fhir
from app.api.fhir.answers import FhirErrors
from app.api.known_parameters import require_known_parameters
from app.api.methods import Methods
from app.api.problems import install_problem_handlers
from app.api.rate_limit import EnrolmentLimit
from app.api.request_log import RequestLog
from app.api.sign_in_limits import SignInLimits
from app.api.state import ApiState
from app.api.waiting import MealWaiter
from app.dashboard import api_reference
from app.dashboard import routes as dashboard
from app.dashboard.answers import DashboardAnswers
from app.dashboard.static_files import DashboardFiles
from app.db.session import open_database
from app.jobs.queue import JobQueue
from app.metrics.instruments import tell_build
from app.services.after_meal import SubmitAfterPair
from app.services.api_children import ApiChildren
from app.services.declare_meal import DeclareMeal
from app.services.erase import Eraser
from app.services.erasure_ledger import ErasureLedger
from app.services.event_rules import EVENT_RULES
from app.services.export_me import ExportPlaces
from app.services.figures import DeploymentFigures
from app.services.last_use import LastUse
from app.services.meal_events import MealEvents
from app.services.passwords import Passwords
from app.services.prepare import prepare_patiently
from app.services.prepare_apart import prepare_apart
from app.services.secret_box import open_secret_box
from app.services.submit_meal import SubmitMeal
from app.settings import Settings
from app.storage.opening import open_blob_store

DESCRIPTION = """
Image-based dietary assessment. A phone sends a meal as two photographs, from the left and from the right, with a
printed checkerboard beside the plate; the server measures each food's volume, turns it into grams and nutrients, and
serves records. Times are RFC 3339 with offset; units stand in the names; errors are RFC 9457 problem documents with a
stable `code`.
"""


@asynccontextmanager
async def open_parts(settings: Settings) -> AsyncIterator[ApiState]:
    """What the endpoints of one process share: opened at its start, closed at its end."""
    tell_build("api")
    box = open_secret_box(settings)
    database = open_database(settings)
    blobs = open_blob_store(settings.resolved_blob_url, settings)
    try:
        await anyio.to_thread.run_sync(lambda: prepare_patiently(database, settings, first=prepare_apart))
    except BaseException:
        database.dispose()
        raise
    queue = JobQueue()
    waiter = MealWaiter(database)
    last_use = LastUse(database)
    children = ApiChildren(settings)
    try:
        children.start_soon()
        yield ApiState(
            settings,
            database,
            blobs,
            parts=(
                queue,
                SubmitMeal(database, blobs, queue, settings, box, children),
                SubmitAfterPair(database, blobs, queue, settings, box, children),
                MealEvents(database, queue, EVENT_RULES),
                DeclareMeal(database, box),
                waiter,
                CallLimits(settings),
                EnrolmentLimit(settings.enrolment_attempts_per_minute),
                box,
                children,
                Eraser(database, box, ErasureLedger(open_blob_store(settings.resolved_erasure_url, settings), box)),
                SignInLimits(settings.sign_in_attempts_per_minute),
                Passwords(),
                ExportPlaces(),
                last_use,
                DeploymentFigures(database, blobs, settings),
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
        yield


def create_app(settings: Settings) -> FastAPI:
    """The app of one process."""
    app = FastAPI(
        title="tada-server",
        version=__version__,
        description=DESCRIPTION,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        lifespan=lifespan,
        dependencies=[Depends(authorise), Depends(require_known_parameters)],
        docs_url=None,  # FastAPI's load their scripts from another host
        redoc_url=None,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.settings = settings
    install_problem_handlers(app)
    app.add_middleware(Methods)
    app.add_middleware(BodyLimit)
    app.add_middleware(AddressLimit)  # before a body is read
    app.add_middleware(FhirErrors)  # around all that answers with a problem document
    app.add_middleware(ApiAnswers)
    app.add_middleware(RequestLog)
    app.add_middleware(DashboardAnswers)
    app.mount("/dashboard/static", DashboardFiles())
    app.add_route(api_reference.PATH, api_reference.api_reference, include_in_schema=False)
    for resource in (
        meal_lists,
        meals,
        meal_jobs,
        photographs,
        checks,
        calibrations,
        me_privacy,
        receipts,
        after_meal,
        audit,
        records,
        data_dictionary,
        study_photographs,
        changes,
        exports,
        releases,
        fhir,
        review,
        review_queue,
        questions,
        declared,
        days,
        summary,
        adequacy,
        overview,
        foods,
        food_edits,
        food_groups,
        reference_intakes,
        me,
        enrolments,
        sessions,
        tokens,
        staff,
        studies,
        study_members,
        participants,
        devices,
        study_densities,
        study_vessels,
        webhooks,
        server,
        health,
        metrics,
        dashboard,
    ):
        app.include_router(resource.router)
    app.openapi = lambda: openapi_document(app)  # type: ignore[method-assign]  # FastAPI's own way to extend it
    return app
