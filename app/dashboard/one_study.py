"""A page below a study's address shows that study and no other, whatever else its viewer may see."""

from dataclasses import replace

from app.core.errors import NotFoundError
from app.dashboard.page import Page
from app.people.access.caller import StaffCaller


def in_study(page: Page) -> StaffCaller:
    """The caller as far as the study of the page goes: a meal of another study does not exist for it.

    Raises NotFoundError: the page is of no study, or the caller has no role in it.
    """
    if page.study is None or page.role is None:
        raise NotFoundError("There is no such study.")
    return replace(page.caller, is_admin=False, roles={page.study.id: page.role}, only_study_id=page.study.id)
