"""/v1/studies/{study}/adequacy: the share of each group whose usual intake lies below the EAR."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.diary.adequacy import judge_study
from app.diary.adequacy_schemas import AdequacyOut
from app.http.flat_list import ListRoute
from app.http.paging import require_order
from app.http.parameters import FirstDay, LastDay, StudyCode
from app.http.problems import problem_responses
from app.people.access.deps import CurrentStaff, State

router = APIRouter(prefix="/v1/studies", tags=["days"], route_class=ListRoute)


@router.get("/{study}/adequacy", responses=problem_responses(401, 403, 404, 422))
def get_adequacy(
    study: StudyCode,
    state: State,
    staff: CurrentStaff,
    component: Annotated[
        str, Query(max_length=64, description="Number, tagname or record's column: 401, VITC.")
    ],
    first_day: FirstDay = None,
    last_day: LastDay = None,
) -> AdequacyOut:
    """Each life stage's persons, days, variances and share below the EAR, or the reason why there is no share."""
    require_order(first_day, last_day)
    judged = judge_study(
        state.database, staff, study, component, first_day=first_day, last_day=last_day
    )
    return AdequacyOut.model_validate(judged, from_attributes=True)
