"""The dashboard's routes, a file a page. Who may see which: app/api/pages.py."""

from fastapi import APIRouter

from app.dashboard import (
    account,
    audit,
    devices,
    exports,
    food_forms,
    foods,
    intake_files,
    item_actions,
    marker,
    meal,
    meal_list,
    members,
    no_such_page,
    overview,
    participant,
    participants,
    releases,
    review,
    settings_pages,
    sign_in,
    staff,
    studies,
    study_densities,
    study_vessels,
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
    no_such_page,  # the last: it has every address that is left
):
    router.include_router(page.router)
