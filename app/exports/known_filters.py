"""A filter that names what is not there is a mistake, not a list without rows."""

from app.core.errors import InvalidInputError, NotFoundError
from app.db.session import Database
from app.foods import queries as foods
from app.http.row_filter import RowFilter
from app.people.access.caller import Caller, visible_rows
from app.records.page_queries import participants_of, studies_of


def require_known(database: Database, caller: Caller, chosen: RowFilter) -> None:
    """Check that study, participant and foods are there, and that the caller may see the first two.

    Raises NotFoundError, InvalidInputError (`food_unknown`).
    """
    if chosen.study_code is None and chosen.participant_code is None and not chosen.food_keys:
        return
    visible = visible_rows(caller, chosen)
    with database.read() as session:
        studies = studies_of(session, visible.study_code, visible.study_ids)
        if chosen.study_code is not None and not studies:
            raise NotFoundError("There is no such study.")
        people = participants_of(session, visible.participant_code, visible.participant_id, studies)
        if chosen.participant_code is not None and not people:
            raise NotFoundError("There is no such participant.")
        unknown = set(chosen.food_keys) - foods.known_keys(session, chosen.food_keys)
    if unknown:
        raise InvalidInputError(f"There is no food {min(unknown)}.", code="food_unknown")
