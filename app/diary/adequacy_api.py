"""/v1/studies/{study}/adequacy: the share of each group whose usual intake lies below the EAR."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.diary.adequacy import StageAdequacy, judge_study
from app.diary.adequacy_schemas import AdequacyOut, StageAdequacyOut, VariancesOut
from app.http.flat_list import ListRoute
from app.http.paging import require_order
from app.http.parameters import FirstDay, LastDay, StudyCode
from app.http.problems import problem_responses
from app.people.access.deps import CurrentStaff, State

router = APIRouter(prefix="/v1/studies", tags=["days"], route_class=ListRoute)

METHOD = (
    "EAR cut-point (Beaton 1994) on usual intakes from closed days, adjusted for day-to-day variation "
    "(NRC 1986, IOM 2000)."
)


@router.get("/{study}/adequacy", responses=problem_responses(401, 403, 404, 422))
def get_adequacy(
    study: StudyCode,
    state: State,
    staff: CurrentStaff,
    component: Annotated[str, Query(max_length=64, description="Number, tagname or record's column: 401, VITC.")],
    first_day: FirstDay = None,
    last_day: LastDay = None,
) -> AdequacyOut:
    """Each life stage's persons, days, variances, and the share below the EAR, or why it cannot be told."""
    require_order(first_day, last_day)
    judged = judge_study(state.database, staff, study, component, first_day=first_day, last_day=last_day)
    return AdequacyOut(
        number=judged.component.number,
        tagname=judged.component.tagname,
        name=judged.component.name,
        unit=judged.component.unit,
        groups=[_group(group) for group in judged.groups],
        persons_without_stage=judged.persons_without_stage,
        method=METHOD,
    )


def _group(group: StageAdequacy) -> StageAdequacyOut:
    found, reference = group.found, group.reference
    return StageAdequacyOut(
        life_stage=group.stage,
        persons=group.persons,
        days=group.days,
        days_left_out=group.days_left_out,
        ear=reference.ear if reference else None,
        per=reference.per if reference else None,
        compared_with=reference.compared_with if reference else None,
        mean_usual_intake=found.mean if found else None,
        share_below_ear=found.share_below if found else None,
        share_interval=(found.share_low, found.share_high) if found else None,
        unadjusted_share=found.unadjusted_share if found else None,
        variances=VariancesOut(scale=found.scale, within=found.variances.within, between=found.variances.between)
        if found
        else None,
        reason=group.reason,
    )
