"""The page of a meal: photographs with outlines, foods, how they were measured, and the meal's history."""

import hashlib
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Annotated, Literal, TypedDict, TypeVar

from fastapi import APIRouter, Form, Header, Query
from starlette.responses import HTMLResponse, Response, StreamingResponse

from app.core.errors import InvalidInputError, TadaError
from app.dashboard.meal_pages.event_form import HAND_LABELS, EventForm
from app.dashboard.meal_pages.event_form import LABELS as FIELD_LABELS
from app.dashboard.meal_pages.flag_words import doubts_of, flag_meaning
from app.dashboard.meal_pages.meal_timeline import TITLES, Entry, event_entry, food_names, timeline
from app.dashboard.page import CurrentPage, Page
from app.foods.schemas import NutrientAmount, NutrientTotal
from app.meals.stored.item_state import REPLACED, UNDONE
from app.meals.upload import read_api as meals
from app.nutrition.components import HEADLINES
from app.people.access.page_rules import MEAL, study_address
from app.photos.slots import SLOTS, PhotographSlot, VoiceSlot
from app.privacy.erase import Eraser
from app.records import serve_photo as photographs
from app.records.read_meal import read_meal
from app.records.render import render_meal, tagged_meal
from app.records.review.meal_history import MealStory, read_story

Nutrient = TypeVar("Nutrient", NutrientAmount, NutrientTotal)
Rings = Sequence[Sequence[tuple[float, float]]]

# picture of a step -> (title, what it shows)
FIGURES: Mapping[str, tuple[str, str]] = {
    "overlay.jpg": (
        "Outlines",
        "The left photograph with the outline and the volume of each food.",
    ),
    "matches.jpg": (
        "Matches",
        "Both photographs side by side; lines join matching points.",
    ),
    "rectified.jpg": (
        "Rectified",
        "The pair from which depth is measured: matching points lie on the same green row of both pictures.",
    ),
    "disparity.jpg": (
        "Disparity",
        "The left rectified picture and each pixel's disparity: blue is far, red is near, black is not matched.",
    ),
    "points.jpg": (
        "Points",
        "The foods' points from the side: measured points in colour, the completed hidden side in grey.",
    ),
    "slices.jpg": (
        "Slices",
        "The foods from above, a circle or ellipse for each slice, coloured by its height.",
    ),
    "topview.jpg": ("From above", "The scene as seen straight from above, in the table's plane."),
}
router = APIRouter(include_in_schema=False)

GONE = frozenset({REPLACED, UNDONE})  # flags of items that other items replace


def outline_path(rings: Rings) -> str:
    """Return rings as an SVG path; holes by the even-odd rule."""
    return " ".join(
        "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in ring) + " Z"
        for ring in rings
        if len(ring) > 0
    )


def label_place(rings: Rings) -> tuple[float, float] | None:
    """Return the position of an item's number: the mean of its outer ring's corners; None without an outline."""
    if not rings or not rings[0]:
        return None
    xs, ys = [x for x, _ in rings[0]], [y for _, y in rings[0]]
    return sum(xs) / len(xs), sum(ys) / len(ys)


def headline(nutrients: Iterable[Nutrient]) -> list[Nutrient]:
    """Return the headline components, energy first."""
    by_number = {nutrient.number: nutrient for nutrient in nutrients}
    headlines = [headline.best_of(by_number) for headline in HEADLINES]
    return [nutrient for nutrient in headlines if nutrient is not None]


def as_runs(digest: str) -> list[str]:
    """Split a checksum into groups of eight characters, which are easier to compare."""
    return [digest[start : start + 8] for start in range(0, len(digest), 8)]


@router.get(MEAL)
def get_meal(
    page: CurrentPage,
    participant: str,
    meal_id: uuid.UUID,
    format: Annotated[Literal["html", "json"], Query()] = "html",  # noqa: A002  # the parameter's name
) -> Response:
    """The page, or the JSON of `GET /v1/meals/{id}`."""
    if format == "json":
        answer = tagged_meal(read_meal(page.database, page.study_caller, meal_id, participant))
        answer.headers["Content-Disposition"] = f'attachment; filename="meal-{meal_id}.json"'
        return answer
    return render_meal_page(page, participant, meal_id, is_section=False)


@router.get(MEAL + "/state")
def get_state(page: CurrentPage, participant: str, meal_id: uuid.UUID) -> Response:
    """The meal's state, which the page polls while something is being measured; then the meal's whole section."""
    view = read_meal(page.database, page.study_caller, meal_id, participant)
    if not meals.will_change(view):
        answer = render_meal_page(page, participant, meal_id, is_section=True)
        answer.headers.update(
            {"HX-Retarget": "#meal", "HX-Reswap": "outerMorph"}
        )  # a morph keeps entered text
        return answer
    return page.render(
        "meal_state.html",
        row=view.meal,
        is_moving=True,
        here=meal_address(page, participant, meal_id),
    )


@router.get(MEAL + "/images/{slot}")
def get_image(
    page: CurrentPage,
    participant: str,
    meal_id: uuid.UUID,
    slot: PhotographSlot | VoiceSlot,
    width: Annotated[
        int, Query(ge=photographs.MIN_WIDTH_PX, le=photographs.MAX_WIDTH_PX)
    ] = photographs.DEFAULT_WIDTH_PX,
    colour: Annotated[Literal["corrected", "as_taken"], Query()] = "corrected",
    if_none_match: Annotated[str | None, Header(max_length=500)] = None,
) -> Response:
    """A photograph as a picture, or the voice note; the audit log records it, as over the API."""
    return photographs.get_photograph(
        meal_id,
        slot,
        page.request,
        page.state,
        page.study_caller,
        width,
        colour,
        participant,
        if_none_match,
    )


@router.get(MEAL + "/artefacts/{name}")
def get_step(
    page: CurrentPage,
    participant: str,
    meal_id: uuid.UUID,
    name: str,
    pair: Annotated[Literal["meal", "after"], Query()] = "meal",
) -> StreamingResponse:
    """An artefact of a run: a picture, the points or the scene; the audit log records it, as over the API."""
    return meals.get_artefact(meal_id, name, page.state, page.study_caller, participant, pair)


@router.post(MEAL + "/retry")
def post_retry(page: CurrentPage, participant: str, meal_id: uuid.UUID) -> Response:
    """Queue the failed estimates again."""
    meals.post_retry(meal_id, page.state, page.study_caller, participant)
    return page.redirect(meal_address(page, participant, meal_id), "The meal is queued again.")


@router.post(MEAL + "/cancel")
def post_cancel(page: CurrentPage, participant: str, meal_id: uuid.UUID) -> Response:
    """Cancel an estimate that is not finished."""
    meals.post_cancel(meal_id, page.state, page.study_caller, participant)
    return page.redirect(
        meal_address(page, participant, meal_id),
        "The estimate was cancelled. The photographs are kept.",
    )


@router.post(MEAL + "/erasure")
def post_erasure(
    page: CurrentPage,
    participant: str,
    meal_id: uuid.UUID,
    typed: Annotated[str, Form(max_length=200)] = "",
) -> Response:
    """Erase the meal for good if the participant's code was entered. Raises InvalidInputError."""
    caller = page.study_caller
    view = read_meal(page.database, caller, meal_id, participant)
    if typed.strip() != view.participant_code:
        raise InvalidInputError(
            f"Nothing was erased. To erase the meal, type the participant's code: {participant}."
        )
    receipt = page.state.part(Eraser).erase_meal(caller, meal_id, participant)
    return page.redirect(
        study_address(page.study_code, "meals"), f"The meal was erased. Receipt {receipt.id}."
    )


@dataclass(frozen=True, slots=True)
class Refused:
    """A form that was not saved: others had changed the meal, or its amount is implausible."""

    form: EventForm
    error: TadaError


def meal_address(page: Page, participant: str, meal_id: uuid.UUID) -> str:
    """Return the address of a meal's page in the current study."""
    return study_address(page.study_code, "meals", participant, meal_id)


def render_meal_page(
    page: Page,
    participant: str,
    meal_id: uuid.UUID,
    *,
    is_section: bool,
    refused: Refused | None = None,
    saved: str | None = None,
) -> HTMLResponse:
    """Render a meal's page, or only its section for htmx. Raises NotFoundError, ConflictError.

    saved: a sentence about the event that was saved.
    """
    story = read_story(page.database, page.study_caller, meal_id, participant)
    view, meal = story.view, render_meal(story.view)
    scene_names = _scene_names(story)
    numbers = {item.id: number for number, item in enumerate(meal.items, start=1)}
    run, here = view.run, meal_address(page, view.participant_code, meal_id)
    return page.render(
        "meal_body.html" if is_section else "meal.html",
        status=refused.error.status if refused is not None else 200,
        story=story,
        meal=meal,
        row=view.meal,
        items=[item for item in meal.items if not GONE & set(item.flags)],
        gone=[item for item in meal.items if GONE & set(item.flags)],
        numbers=numbers,
        doubts=doubts_of(meal.items, numbers),
        images=dict(
            sorted(
                ((image.slot, image) for image in view.images),
                key=lambda pair: SLOTS.index(pair[0]),
            )
        ),
        colour=run.colour if run is not None else None,
        steps={artefact.name: artefact for artefact in view.artefacts},
        run_id=run.id if run is not None else None,
        entries=timeline(story),
        delay_seconds=(meal.received_at - meal.captured_at) / timedelta(seconds=1),
        is_moving=meals.will_change(view),
        here=here,
        may_review=page.may("reviewer"),
        new_id=uuid.uuid4,
        figures=FIGURES,
        outline=outline_path,
        place=label_place,
        headline=headline,
        flag_meaning=flag_meaning,
        runs_of_text=as_runs,
        scene_items=_scene_items(story),
        scene_names=scene_names,
        hand_forms=_hand_forms(story),
        hand_labels=HAND_LABELS,
        scene_id=hashlib.sha256(
            "\n".join([str(run and run.id), *scene_names]).encode()
        ).hexdigest()[:12],
        files_of_steps=_files(story, here),
        conflict=_conflict(story, refused) if refused is not None else None,
        saved=saved,
    )


@dataclass(frozen=True, slots=True)
class Conflict:
    """An event that was not saved, and can be sent again.

    changes: of the meal by others meanwhile. is_doubtful: its amount is implausible.
    values: of the refused event, by label. fields: of its form.
    """

    changes: list[Entry]
    is_doubtful: bool
    title: str
    values: list[tuple[str, str]]
    fields: dict[str, str]


def _conflict(story: MealStory, refused: Refused) -> Conflict:
    form, is_doubtful = refused.form, isinstance(refused.error, InvalidInputError)
    names, fields = food_names(story), form.filled_fields()
    shown = {
        name: names.get(value, value) for name, value in fields.items() if name in FIELD_LABELS
    }
    return Conflict(
        changes=[event_entry(row, names) for row in story.events if row.event.sequence > form.seen],
        is_doubtful=is_doubtful,
        title=TITLES.get(form.kind, form.kind),
        values=[
            (FIELD_LABELS[name].lower(), value)
            for name, value in shown.items()
            if name != "polygon"
        ],
        fields=fields | ({"accepts": "yes"} if is_doubtful or form.accepts else {}),
    )


class SceneItem(TypedDict):
    """An item as the page's scripts know it."""

    id: str
    number: int


def _scene_items(story: MealStory) -> dict[int, SceneItem]:
    """Return position in the run's scene -> item, for items that are still as the run measured them."""
    run = story.view.run
    return {
        view.item.position: {"id": str(view.item.id), "number": number}
        for number, view in enumerate(story.view.items, start=1)
        if run is not None
        and view.item.run_id == view.record.run_id == run.id
        and view.record.status != "rejected"
    }


def _hand_forms(story: MealStory) -> dict[str, dict[str, object]]:
    """Return item -> the fields of the form that a person last gave it in the frame of the current run."""
    run, forms = story.view.run, {}
    for row in story.events:
        event = row.event
        if (
            event.kind == "reshape"
            and not row.is_undone
            and run is not None
            and event.new["run"] == str(run.id)
        ):
            form = event.new["form"]
            forms[str(event.item_id)] = form | dict(
                zip(("x_mm", "y_mm"), form["centre_mm"], strict=True)
            )
    return forms


def _scene_names(story: MealStory) -> list[str]:
    """Return the names of the run's foods in the scene's order; "" for an unknown food."""
    run = story.view.run
    of_run = {
        view.item.position: view.food
        for view in story.view.items
        if run and view.item.run_id == run.id
    }
    foods = [of_run.get(position) for position in range(1 + max(of_run, default=-1))]
    return [food.name if food is not None else "" for food in foods]


def _files(story: MealStory, here: str) -> list[tuple[str, str]]:
    """Return (name, address) of the run's artefacts."""
    run = story.view.run
    return [
        (artefact.name, f"{here}/artefacts/{artefact.name}?run={run.id}")
        for artefact in story.view.artefacts
        if run is not None
    ]
