"""/v1/studies/{study}/overview: the figures of a study's overview, and each table of it as a file."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, Literal, get_args

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from app.core.errors import InvalidInputError
from app.diary.distribution import Distribution
from app.diary.overview_queries import CountedStatus
from app.diary.overview_schemas import (
    BinOut,
    CompletenessOut,
    FailureCountOut,
    OverviewDayOut,
    OverviewNutrientOut,
    OverviewOut,
    OverviewPeopleOut,
    OverviewStatusOut,
    PersonDayOut,
    PlaceOut,
)
from app.diary.study_overview import (
    OverviewDay,
    StudyOverview,
    note_overview_export,
    study_overview,
)
from app.exports.export_files import MEDIA_TYPES
from app.http.parameters import FirstDay, LastDay, StudyCode
from app.http.problems import problem_responses
from app.http.tables.flat_rows import encode_flat, flat_paths
from app.meals.models import MealStatus
from app.people.access.deps import CurrentStaff, State

router = APIRouter(prefix="/v1/studies", tags=["days"])

Part = Literal[
    "participants",
    "completeness",
    "days",
    "statuses",
    "waiting",
    "failures",
    "nutrients",
    "histograms",
    "person_days",
    "places",
]
ROWS: Mapping[Part, type[BaseModel]] = {
    "participants": OverviewPeopleOut,
    "completeness": CompletenessOut,
    "days": OverviewDayOut,
    "statuses": OverviewStatusOut,
    "waiting": OverviewStatusOut,
    "failures": FailureCountOut,
    "nutrients": OverviewNutrientOut,
    "histograms": BinOut,
    "person_days": PersonDayOut,
    "places": PlaceOut,
}


@router.get(
    "/{study}/overview",
    response_model=OverviewOut,
    responses={
        200: {
            "content": {"text/csv": {"schema": {"type": "string"}}},
            "description": "All of it, or a table of it as a file.",
        },
        **problem_responses(401, 403, 404, 422),
    },
)
def get_overview(
    study: StudyCode,
    state: State,
    staff: CurrentStaff,
    first_day: FirstDay = None,
    last_day: LastDay = None,
    output: Annotated[
        Literal["json", "csv", "ndjson"],
        Query(alias="format", description="csv, ndjson: one table, which `part` names, as a file."),
    ] = "json",
    part: Annotated[Part | None, Query(description="Which table, with format=csv or ndjson.")] = None,
) -> Response:
    """People, days, what waits, nutrients and places; without a range, the last 28 days that anything is known of."""
    if output != "json" and part is None:
        raise InvalidInputError(
            f"As a file it comes a table at a time: part={', '.join(get_args(Part))}.", code="overview_part_missing"
        )
    found = overview_out(study_overview(state.database, staff, study, first_day=first_day, last_day=last_day))
    if output == "json" or part is None:
        return JSONResponse(found.model_dump(mode="json"))
    note_overview_export(state.database, staff, study, part, output)
    named = {"Content-Disposition": f'attachment; filename="overview-{part}.{output}"'}
    content = b"".join(encode_flat(output, flat_paths(ROWS[part]), rows_of(found, part)))
    return Response(content, media_type=MEDIA_TYPES[output], headers=named)


def rows_of(found: OverviewOut, part: Part) -> list[dict[str, Any]]:
    """The rows of a table of the overview, as its file has them."""
    table = getattr(found, part)
    return [row.model_dump(mode="json") for row in (table if isinstance(table, list) else [table])]


def overview_out(found: StudyOverview) -> OverviewOut:
    """The overview as it goes over the wire."""
    places = found.places
    return OverviewOut(
        study=found.study,
        first_day=found.first_day,
        last_day=found.last_day,
        participants=OverviewPeopleOut(**found.people._asdict()),
        completeness=CompletenessOut(**asdict(found.completeness)),
        days=[_day_out(day) for day in found.days],
        statuses=_statuses_out(found.by_status),
        waiting=_statuses_out(found.waiting),
        failures=[FailureCountOut(failure_code=code, meals=meals) for code, meals in found.failures.items()],
        nutrients=[_nutrient_out(each) for each in found.nutrients],
        histograms=[row for each in found.nutrients for row in _bins_out(each)],
        person_days=[
            PersonDayOut(
                participant=each.participant_code,
                local_date=each.local_date,
                expected=each.is_expected,
                closed=each.is_closed,
                meals=each.meals,
            )
            for each in (found.person_days or ())
        ],
        located_meals=places.total if places is not None else None,
        places=[
            PlaceOut(
                meal_id=place.meal_client_id,
                participant=place.participant_code,
                captured_at=place.captured_at,
                local_date=place.local_date,
                latitude=place.latitude,
                longitude=place.longitude,
            )
            for place in (places.shown if places is not None else ())
        ],
    )


def _day_out(day: OverviewDay) -> OverviewDayOut:
    counts = asdict(day.counts)
    by_status = {f"{status}_meals": meals for status, meals in counts.pop("by_status").items()}
    return OverviewDayOut(
        expected=day.expected,
        silent=day.silent,
        told_open=day.counts.told_open,
        late_share=day.counts.late_share,
        median_delay_seconds=day.median_delay_seconds,
        **counts,
        **by_status,
    )


def _statuses_out(counts: Mapping[CountedStatus, int] | Mapping[MealStatus, int]) -> list[OverviewStatusOut]:
    return [OverviewStatusOut(status=status, meals=meals) for status, meals in counts.items()]


def _nutrient_out(found: Distribution) -> OverviewNutrientOut:
    return OverviewNutrientOut(
        component=found.column,
        days=found.days,
        mean=found.mean,
        sd=found.sd,
        median=found.median,
        minimum=found.minimum,
        maximum=found.maximum,
        days_below_bins=found.below,
        days_above_bins=found.above,
    )


def _bins_out(found: Distribution) -> list[BinOut]:
    return [
        BinOut(component=found.column, from_amount=found.edges[n], to_amount=found.edges[n + 1], days=days)
        for n, days in enumerate(found.counts)
    ]
