"""From the services' views to the wire's models."""

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from app.diary.study_days import number_of
from app.foods.food_amounts import FoodAmounts
from app.foods.models import Component, Food
from app.foods.schemas import FoodRef, NutrientAmount, NutrientTotal
from app.http.stored_words import stored_word
from app.meals.meal_clock import time_flags
from app.meals.models import AFTER_SLOTS, SLOTS
from app.meals.record_models import HEADLINE_COLUMNS, EffectiveRecord, RunArtefact
from app.nutrition.doubt import Estimate
from app.nutrition.foods import DENSITY_BASES, FOOD_FORMS
from app.nutrition.nutrients import amount_interval
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
)
from app.records.queries import FoodName, RecordRow
from app.records.read_after import LeftoverView
from app.records.read_meal import ItemView, MealView
from app.records.record_amounts import nutrient_interval
from app.records.schemas import RecordOut
from app.uploads.submit_meal import IGNORED

SHARED_COLUMNS = tuple(
    column.name for column in EffectiveRecord.__table__.columns if column.name in RecordOut.model_fields
)


def render_meal(view: MealView) -> MealOut:
    """A meal as the API shows it."""
    meal, run = view.meal, view.run
    images = {image.slot: image for image in view.images}
    return MealOut(
        id=meal.client_id,
        study=view.study_code,
        participant=view.participant_code,
        status=meal.status,
        stage=meal.stage,
        captured_at=meal.captured_at,
        time_zone=meal.time_zone,
        local_date=meal.local_date,
        received_at=meal.received_at,
        version=meal.version,
        flags=time_flags(meal),
        ignored=meal.details.get(IGNORED, []),
        images={slot: ImageOut.model_validate(images[slot], from_attributes=True) for slot in SLOTS if slot in images},
        missing=[slot for slot in SLOTS if slot not in images],
        failure=FailureOut(code=meal.failure_code, message=meal.failure_message or "", advice=meal.failure_advice or "")
        if meal.failure_code
        else None,
        after=render_after(view),
        items=[_item(item, view.components) for item in view.items],
        totals=_totals(view),
        run=RunOut(
            id=run.id,
            method=run.method,
            pipeline_version=run.pipeline_version,
            marker=run.marker,
            camera=run.camera,
            parameters=run.parameters,
            stages=run.stages,
            seconds=run.seconds,
            food_tables=run.food_releases,
            created_at=run.created_at,
            artefacts=[_artefact(view, artefact) for artefact in view.artefacts],
        )
        if run
        else None,
    )


def render_after(view: MealView) -> AfterOut | None:
    """The after-meal pair, if there is one or one is waited for."""
    meal, details = view.meal, view.meal.after_details
    if meal.after_status is None and meal.after_due_at is None:
        return None
    images = {image.slot: image for image in view.images}
    return AfterOut(
        status=meal.after_status,
        due_at=meal.after_due_at,
        captured_at=datetime.fromisoformat(details["captured_at"]) if details is not None else None,
        ignored=details.get(IGNORED, []) if details is not None else [],
        images={
            slot: ImageOut.model_validate(images[slot], from_attributes=True) for slot in AFTER_SLOTS if slot in images
        },
        missing=[slot for slot in AFTER_SLOTS if slot not in images],
        failure=FailureOut(
            code=meal.after_failure_code,
            message=meal.after_failure_message or "",
            advice=meal.after_failure_advice or "",
        )
        if meal.after_failure_code
        else None,
        leftovers=[_leftover(each) for each in view.after.leftovers],
        artefacts=[_artefact(view, artefact, "?pair=after") for artefact in view.after.artefacts],
    )


def render_record(row: RecordRow) -> RecordOut:
    """A record as the API shows it."""
    columns: dict[str, Any] = {name: getattr(row.record, name) for name in SHARED_COLUMNS}
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
        nutrient_intervals={name: nutrient_interval(row.record, name) for name in HEADLINE_COLUMNS},
        **columns | {"meal_id": row.meal_client_id},
    )


def food_ref(food: Food | FoodName | None) -> FoodRef | None:
    """A food by key and name."""
    return FoodRef(key=food.key, name=food.name) if food is not None else None


def _leftover(view: LeftoverView) -> LeftoverOut:
    leftover, state = view.state, view.state.state
    mass = view.mass.as_seen_g if view.mass is not None else None
    of_class: dict[str, Any] = {"class": leftover.leftover_class}  # no name for an argument in Python
    return LeftoverOut(
        id=state.item.id,
        item=leftover.of_item_id,
        is_by_person=leftover.is_by_person,
        polygon=[list(ring) for ring in state.rings],
        food=food_ref(view.food),
        volume_ml=state.amount.volume_ml,
        volume_interval_ml=_interval(state.amount.volume_low_ml, state.amount.volume_high_ml),
        mass_g=mass.value if mass is not None else None,
        mass_interval_g=(mass.low, mass.high) if mass is not None else None,
        flags=[*state.flags, *leftover.flags],
        **of_class,
    )


def _artefact(view: MealView, artefact: RunArtefact, query: str = "") -> ArtefactOut:
    return ArtefactOut(
        name=artefact.name,
        media_type=artefact.media_type,
        bytes=artefact.bytes,
        href=f"/v1/meals/{view.meal.client_id}/artefacts/{artefact.name}{query}",
    )


def _item(view: ItemView, components: Mapping[str, Component]) -> ItemOut:
    record, its = view.record, view.state.taken_for
    density = its if record.density_g_per_ml is not None else None
    return ItemOut(
        id=record.item_id,
        status=record.status,
        origin=record.origin,
        polygon=[list(ring) for ring in view.state.rings],
        food=food_ref(view.food),
        lies_as=stored_word(its.lies_as, FOOD_FORMS) if its else None,
        candidates=[
            CandidateOut(food=FoodRef(key=food.key, name=food.name), probability=probability, source=source)
            for food, probability, source in view.candidates
        ],
        none_of_these=view.none_probability,
        index_version=view.index_version,
        volume_ml=record.volume_ml,
        volume_interval_ml=_interval(record.volume_low_ml, record.volume_high_ml),
        density_g_per_ml=record.density_g_per_ml,
        density_sd_g_per_ml=density.density_sd_g_per_ml if density else None,
        density_basis=stored_word(density.density_basis, DENSITY_BASES) if density else None,
        density_source=record.density_source,
        mass_g=record.mass_g,
        mass_interval_g=_interval(record.mass_low_g, record.mass_high_g),
        edible_share=its.edible_share if its else None,
        edible_g=record.edible_g,
        share=record.share,
        left_g=record.left_g,
        consumed_g=record.consumed_g,
        consumed_interval_g=_interval(record.consumed_low_g, record.consumed_high_g),
        provisional=record.provisional,
        reviewed=record.reviewed,
        parent=view.state.item.parent_id,
        open_probes=list(view.open_probes),
        nutrients=list(_nutrients(view.amounts, components)),
        flags=record.flags,
    )


def _nutrients(amounts: FoodAmounts | None, components: Mapping[str, Component]) -> Iterator[NutrientAmount]:
    if amounts is None or amounts.consumed_g is None:
        return
    for number, amount in amounts.nutrients.items():
        interval = amount_interval(amount, amounts.consumed_g)
        yield NutrientAmount(**_component(components[number]), amount=amount.value, interval=interval)


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


def _interval(low: float | None, high: float | None) -> tuple[float, float] | None:
    return (low, high) if low is not None and high is not None else None
