"""Teach a study a food: choose items, add photographs, see their confusions, put them in force."""

import uuid
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Depends, Query
from starlette.responses import Response

from app.core.errors import InvalidInputError, TadaError
from app.dashboard.forms import EMPTY_FORM, FormState, refused
from app.dashboard.meal_pages.review import outline_of
from app.dashboard.page import CurrentPage, Page
from app.foods.api import FoodKey
from app.foods.foods import read_food
from app.http.upload import UploadLimits, received_parts, require_room
from app.people.access.page_rules import STUDY_PAGES, study_address
from app.records.teach_food import MOST_AT_ONCE, FoodTeaching

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/taught-foods/{{key}}"
ItemsIn = Annotated[list[uuid.UUID], Query(alias="item", default_factory=list)]


def food_teaching(page: CurrentPage, key: FoodKey) -> FoodTeaching:
    """Return the page's food as its study is taught it.

    Raises NotFoundError; InvalidInputError (`food_is_group`).
    """
    food = read_food(page.database, key).food
    if food.is_group:
        raise InvalidInputError("This stands for several foods: teach those.", code="food_is_group")
    return FoodTeaching(page.state, page.study_caller, page.require_study(), food)


Teaching = Annotated[FoodTeaching, Depends(food_teaching)]


@router.get(PATH)
def get_teaching(page: CurrentPage, teaching: Teaching, items: ItemsIn) -> Response:
    """Return the page of what teaches the food. items: chosen to teach it, too."""
    return _render(page, teaching, items)


@router.post(PATH)
def post_teaching(page: CurrentPage, teaching: Teaching, items: ItemsIn) -> Response:
    """Put the drafts and the chosen items in force."""
    chosen = [item for item in teaching.unnamed_items() if item.row.record.item_id in items]
    notice = f"{teaching.put_in_force(chosen)} more examples count from the next meal on."
    return _redirect(page, teaching, notice)


@router.post(f"{PATH}/photographs")
async def post_photographs(page: CurrentPage, teaching: Teaching) -> Response:
    """Add photographs as drafts; they are described and not kept."""
    state = page.state
    await anyio.to_thread.run_sync(require_room, state)
    limits = UploadLimits(photo_bytes=state.settings.max_photo_bytes, metadata_bytes=0)
    staging = state.blobs.staging_folder()
    async with received_parts(
        page.request, ("photo",), staging, limits, state.upload_limiter, times=MOST_AT_ONCE
    ) as parts:

        def add() -> Response:
            try:
                count = teaching.add_photographs(parts.files.values())
            except TadaError as error:
                return _render(page, teaching, [], refused(error, name="photo"))
            return _redirect(page, teaching, f"{count} new photographs are drafts.")

        return await anyio.to_thread.run_sync(add)


@router.post(f"{PATH}/photographs/{{photograph}}/removal")
def post_removal(page: CurrentPage, teaching: Teaching, photograph: uuid.UUID) -> Response:
    """Take a photograph back, in force or not."""
    teaching.take_back(photograph)
    return _redirect(page, teaching, "The photograph teaches no more.")


def _redirect(page: Page, teaching: FoodTeaching, notice: str) -> Response:
    path = study_address(page.study_code, "taught-foods", teaching.food.key)
    return page.redirect(path, notice)


def _render(
    page: Page, teaching: FoodTeaching, items: list[uuid.UUID], form: FormState = EMPTY_FORM
) -> Response:
    unnamed = teaching.unnamed_items()
    chosen = [item for item in unnamed if item.row.record.item_id in items]
    return page.render(
        "teach_food.html",
        form=form,
        food=teaching.food,
        photographs=teaching.photographs(),
        unnamed=unnamed,
        chosen=chosen,
        rankings=teaching.rank_examples(chosen),
        outline_of=outline_of,
    )
