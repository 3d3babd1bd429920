"""The dashboard's routes, one file per page. Permissions are in app/people/access/page_rules.py."""

from fastapi import APIRouter

from app.dashboard import no_such_page
from app.dashboard.data_pages import exports, intake_files, overview, releases, remeasurements
from app.dashboard.food_pages import food_forms, foods, study_densities, study_vessels
from app.dashboard.meal_pages import item_actions, meal, meal_list, review
from app.dashboard.people_pages import (
    account,
    audit,
    devices,
    marker,
    members,
    participant,
    participants,
    settings_pages,
    sign_in,
    staff,
    studies,
    webhooks,
)

router = APIRouter(include_in_schema=False)
for page in (
    sign_in,
    studies,
    overview,
    item_actions,
    review,
    meal_list,
    meal,
    participants,
    participant,
    intake_files,
    exports,
    releases,
    remeasurements,
    devices,
    members,
    webhooks,
    settings_pages,
    staff,
    foods,
    food_forms,
    study_densities,
    study_vessels,
    account,
    audit,
    marker,
    no_such_page,  # must be last: it matches every remaining address
):
    router.include_router(page.router)
