"""/v1/studies/{study}/changes: the changes by which a copy of a study's records is kept up to date."""

from fastapi import APIRouter, Request

from app.exports.lists.change_queries import ChangedDay
from app.exports.lists.change_schemas import ChangedDayOut, ChangePage, ErasedOut
from app.exports.lists.list_changes import list_changes
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.people.access.deps import State
from app.people.privacy_models import Tombstone
from app.records.queries import RecordRow
from app.records.render import render_record
from app.records.schemas import RecordOfItem

router = APIRouter(prefix="/v1/studies", tags=["records"])


@router.get(
    "/{study}/changes", response_model=ChangePage, responses=problem_responses(401, 403, 404, 422)
)
def get_study_changes(
    study: StudyCode,
    request: Request,
    state: State,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> ModelResponse:
    """Records and days that changed or were erased since the previous page, without gaps."""
    page = list_changes(state.database, study, cursor=cursor, limit=limit)
    rows = [change.row for change in page.rows]
    return ModelResponse(
        ChangePage(
            records=[
                RecordOfItem.model_validate(render_record(row), from_attributes=True)
                for row in rows
                if isinstance(row, RecordRow)
            ],
            days=[_changed_day(row) for row in rows if isinstance(row, ChangedDay)],
            erased=[_erased(row) for row in rows if isinstance(row, Tombstone)],
            next=next_page(request, page.cursor) or "",
            has_more=page.has_more,
        )
    )


def _changed_day(row: ChangedDay) -> ChangedDayOut:
    day = row.day
    return ChangedDayOut(
        id=day.id,
        participant=row.participant_code,
        local_date=day.local_date,
        status=day.status,
        ate_nothing=day.ate_nothing,
        change_seq=day.change_seq,
    )


def _erased(row: Tombstone) -> ErasedOut:
    return ErasedOut.model_validate(
        {"kind": row.kind, "id_sha256": row.digest, "change_seq": row.change_seq}
    )
