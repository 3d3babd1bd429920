"""/v1/me/summary: what a participant sees of what they ate; the same for staff."""

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Query

from app.api.deps import CurrentDevice, CurrentStaff, State
from app.api.parameters import ParticipantCode, StudyCode
from app.api.problems import problem_responses
from app.api.schemas.feedback import ComparedOut, ComparisonOut, EatenAmountOut, EatenMealOut, SummaryOut
from app.api.schemas.text import LocalDay
from app.services.diary import Whose
from app.services.feedback import CompareDays, EatenAmount, Feedback, read_feedback

router = APIRouter(prefix="/v1", tags=["feedback"])

Day = Annotated[
    LocalDay | None, Query(alias="date", description="A local day; default: the last one with a meal or a word.")
]


@router.get("/me/summary", responses=problem_responses(401, 403, 410, 422))
def get_my_summary(state: State, device: CurrentDevice, day: Day = None) -> SummaryOut:
    """A day's amounts, from three closed days on beside reference intakes; only if the study gives feedback."""
    return _summary(read_feedback(state.database, device, day))


@router.get("/studies/{study}/participants/{participant}/summary", responses=problem_responses(401, 403, 404, 422))
def get_summary_of_participant(
    study: StudyCode,
    participant: ParticipantCode,
    state: State,
    staff: CurrentStaff,
    day: Day = None,
) -> SummaryOut:
    """What the participant sees, or would see if the study gave feedback."""
    return _summary(read_feedback(state.database, staff, day, Whose(study, participant)))


def _summary(found: Feedback) -> SummaryOut:
    row = found.day.row if found.day is not None else None
    return SummaryOut(
        date=found.local_date,
        study_day=found.day.number if found.day is not None else None,
        status=row.status if row is not None else "open",
        ate_nothing=row is not None and row.ate_nothing,
        meals=[
            EatenMealOut(
                meal_id=meal.client_id,
                captured_at=meal.captured_at,
                items=meal.items,
                unmeasured_items=meal.unmeasured_items,
                components=_amounts(meal.amounts),
            )
            for meal in found.meals
        ],
        components=_amounts(found.amounts),
        unmeasured_meals=found.unmeasured_meals,
        unmeasured_items=found.unmeasured_items,
        provisional_items=found.provisional_items,
        leftovers_unknown_items=found.leftovers_unknown_items,
        comparison=_comparison(found.comparison),
        locale=found.locale,
        sentences=list(found.sentences),
        disclaimer=found.disclaimer,
    )


def _amounts(amounts: Mapping[str, EatenAmount]) -> dict[str, EatenAmountOut]:
    return {
        column: EatenAmountOut(
            amount=each.value,
            interval=(each.low, each.high) if each.low is not None and each.high is not None else None,
            coverage=each.coverage,
        )
        for column, each in amounts.items()
    }


def _comparison(compared: CompareDays) -> ComparisonOut:
    return ComparisonOut(
        window_days=compared.window_days,
        closed_days=compared.closed_days,
        whole_days=compared.whole_days,
        why_not=compared.why_not,
        components={
            column: ComparedOut(
                mean=found.mean,
                interval=(found.low, found.high),
                days=found.days,
                coverage=compared.coverage[column],
                reference=found.reference,
                kind=found.kind,
                verdict=found.verdict,
            )
            for column, found in compared.found.items()
        },
    )
