"""From the services' views to the wire's models."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from pydantic import BaseModel

from app.candidates.item_candidates import ItemCandidates
from app.db.base import Base
from app.foods.models import Component, Food
from app.foods.schemas import FoodRef, NutrientAmount, NutrientTotal
from app.http.model_response import ModelResponse
from app.http.text_schemas import stored_word
from app.meals.stored.meal_time import number_of, time_flags
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Run, RunArtefact
from app.nutrition.doubt import Estimate
from app.nutrition.foods import DENSITY_BASES, FOOD_FORMS
from app.nutrition.nutrients import amount_interval
from app.photos.slots import AFTER_SLOTS, VOICE_NOTE
from app.records.meal_schemas import (
    AfterOut,
    ArtefactOut,
    CandidateOut,
    FailureOut,
    ImageOut,
    ItemOut,
    LeftoverOut,
    MealOut,
    RunOut,
    TotalsOut,
    VoiceNoteOut,
)
from app.records.queries import FoodName, RecordRow
from app.records.read_meal import ItemView, MealView
from app.records.schemas import RecordOut


def shared_columns(table: type[Base], schema: type[BaseModel]) -> tuple[str, ...]:
    """Columns that an answer shows as they are stored, under their own names; `id` means another one there."""
    return tuple(
        each.name
        for each in table.__table__.columns
        if each.name in schema.model_fields and each.name != "id"
    )


RECORD_SHOWN, ITEM_COLUMNS = (
    shared_columns(EffectiveRecord, RecordOut),
    shared_columns(EffectiveRecord, ItemOut),
)
MEAL_COLUMNS = shared_columns(Meal, MealOut)
RUN_COLUMNS = (*shared_columns(Run, RunOut), "id")


def render_meal(view: MealView) -> MealOut:
    """A meal as the API shows it."""
    meal, run = view.meal, view.run
    images, missing = _images(view, meal.announced_slots)
    return MealOut(
        **{name: getattr(meal, name) for name in MEAL_COLUMNS},
        id=meal.client_id,
        study=view.study_code,
        participant=view.participant_code,
        flags=time_flags(meal.origin, meal.captured_at, meal.received_at),
        ignored=meal.details.get("ignored", []),
        images=images,
        missing=missing,
        voice_note=_voice_note(view),
        failure=_failure(meal.failure_code, meal.failure_message, meal.failure_advice),
        after=render_after(view),
        items=[_item(item, view.components) for item in view.items],
        totals=_totals(view),
        run=RunOut(
            **{name: getattr(run, name) for name in RUN_COLUMNS},
            food_tables=run.food_releases,
            artefacts=[_artefact(meal, artefact) for artefact in view.artefacts],
        )
        if run
        else None,
    )


def tagged_meal(view: MealView, status: int = 200, *, is_located: bool = False) -> ModelResponse:
    """Return a meal with its ETag. is_located: with its Location."""
    headers = {"ETag": meal_etag(view)}
    if is_located:
        headers["Location"] = f"/v1/meals/{view.meal.client_id}"
    return ModelResponse(render_meal(view), status_code=status, headers=headers)


def meal_etag(view: MealView) -> str:
    """Return a meal's ETag."""
    return f'"{view.meal.version}"'


def render_after(view: MealView) -> AfterOut | None:
    """The after-meal pair, if there is one or one is waited for."""
    meal, details = view.meal, view.meal.after_details
    if meal.after_status is None and meal.after_due_at is None:
        return None
    images, missing = _images(view, AFTER_SLOTS)
    return AfterOut(
        status=meal.after_status,
        due_at=meal.after_due_at,
        captured_at=datetime.fromisoformat(details["captured_at"]) if details is not None else None,
        ignored=details.get("ignored", []) if details is not None else [],
        images=images,
        missing=missing,
        failure=_failure(
            meal.after_failure_code, meal.after_failure_message, meal.after_failure_advice
        ),
        leftovers=[LeftoverOut.model_validate(piece) for piece in view.leftovers],
        artefacts=[_artefact(meal, artefact, "?pair=after") for artefact in view.after_artefacts],
    )


def render_record(row: RecordRow) -> RecordOut:
    """A record as the API shows it."""
    columns: dict[str, Any] = {name: getattr(row.record, name) for name in RECORD_SHOWN}
    return RecordOut(
        id=row.record.item_id,
        study=row.study_code,
        participant=row.participant_code,
        time_zone=row.time_zone,
        food=food_ref(row.food),
        food_table=row.food_release,
        day_status=row.day_status,
        study_day=number_of(row.record.local_date, row.first_day),
        upload_delay_seconds=(row.received_at - row.record.captured_at).total_seconds(),
        nutrient_intervals=row.record.nutrient_intervals(),
        **columns | {"meal_id": row.meal_client_id},
    )


def food_ref(food: Food | FoodName | None) -> FoodRef | None:
    """A food by key and name."""
    return FoodRef(key=food.key, name=food.name) if food is not None else None


def render_candidates(candidates: ItemCandidates) -> list[CandidateOut]:
    """The foods that an item may be."""
    return [
        CandidateOut.model_validate(each, from_attributes=True) for each in candidates.candidates
    ]


def _images(view: MealView, slots: Sequence[str]) -> tuple[dict[str, ImageOut], list[str]]:
    """The photographs of these slots that have arrived, and the slots that are missing."""
    arrived = {image.slot: image for image in view.images}
    images = {
        slot: ImageOut.model_validate(arrived[slot], from_attributes=True)
        for slot in slots
        if slot in arrived
    }
    return images, [slot for slot in slots if slot not in arrived]


def _voice_note(view: MealView) -> VoiceNoteOut | None:
    note = next(
        (image for image in view.images if image.slot == VOICE_NOTE and image.erased_at is None),
        None,
    )
    return VoiceNoteOut.model_validate(note, from_attributes=True) if note is not None else None


def _failure(code: str | None, message: str | None, advice: str | None) -> FailureOut | None:
    return FailureOut(code=code, message=message or "", advice=advice or "") if code else None


def _artefact(meal: Meal, artefact: RunArtefact, query: str = "") -> ArtefactOut:
    return ArtefactOut(
        name=artefact.name,
        media_type=artefact.media_type,
        bytes=artefact.bytes,
        href=f"/v1/meals/{meal.client_id}/artefacts/{artefact.name}{query}",
    )


def _item(view: ItemView, components: Mapping[str, Component]) -> ItemOut:
    record, row = view.record, view.food_assignment
    density = row if record.density_g_per_ml is not None else None
    identified, rings = view.candidates.identified, record.details["rings"]
    return ItemOut(
        **{name: getattr(record, name) for name in ITEM_COLUMNS},
        id=record.item_id,
        polygon=[
            [(x, y) for x, y in ring] for ring in (view.item.rings if rings is None else rings)
        ],
        food=food_ref(view.food),
        lies_as=stored_word(row.lies_as, FOOD_FORMS) if row else None,
        candidates=render_candidates(view.candidates),
        none_of_these=view.candidates.none_probability,
        index_version=identified.index_version if identified is not None else None,
        volume_interval_ml=record.interval("volume", "ml"),
        density_sd_g_per_ml=density.density_sd_g_per_ml if density else None,
        density_basis=stored_word(density.density_basis, DENSITY_BASES) if density else None,
        mass_interval_g=record.interval("mass", "g"),
        edible_share=row.edible_share if row else None,
        consumed_interval_g=record.interval("consumed", "g"),
        parent=view.item.parent_id,
        open_probes=record.details["open_probes"],
        nutrients=list(_nutrients(view, components)),
    )


def _nutrients(view: ItemView, components: Mapping[str, Component]) -> Iterator[NutrientAmount]:
    eaten = view.record.eaten_g
    if eaten is None:
        return
    for number, amount in view.nutrients.items():
        interval = amount_interval(amount, eaten)
        yield NutrientAmount(
            **_component(components[number]), amount=amount.value, interval=interval
        )


def _totals(view: MealView) -> TotalsOut:
    mass: Estimate | None = view.total_mass.edible_g
    return TotalsOut(
        consumed_g=mass.value if mass is not None else None,
        consumed_interval_g=(mass.low, mass.high) if mass is not None else None,
        unmeasured_items=view.total_mass.unmeasured,
        nutrients=[
            NutrientTotal(
                **_component(view.components[number]),
                amount=total.amount.value,
                interval=amount_interval(total.amount, mass) if mass is not None else None,
                coverage=total.coverage,
            )
            for number, total in view.totals.items()
        ],
    )


def _component(component: Component) -> dict[str, Any]:
    return {
        "number": component.number,
        "tagname": component.tagname,
        "name": component.name,
        "unit": component.unit,
    }
