"""Mean intakes and adequacy as files: the API's lists under the pages' addresses."""

from fastapi import APIRouter

from app.diary.api import get_adequacy
from app.exports.lists.days_api import get_intakes
from app.http.flat_list import ListRoute
from app.people.access.page_rules import STUDY_PAGES

router = APIRouter(include_in_schema=False, route_class=ListRoute)

router.add_api_route(f"{STUDY_PAGES}/files/intakes", get_intakes, methods=["GET"])
router.add_api_route(f"{STUDY_PAGES}/files/adequacy", get_adequacy, methods=["GET"])
