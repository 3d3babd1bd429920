"""What a caller may see and do in a study: the one place that decides, from the caller's role and the route's rule.

The route's rule (access_rules.py) has put into the caller which role it needs. A study where the caller has no role at
all does not exist for them: 404. One where the role is too low says so: 403. An admin has every role everywhere.
"""

import uuid

from app.core.errors import NotAllowedError, NotFoundError
from app.people.access.caller import Caller, DeviceCaller, StaffCaller
from app.people.models import ROLES, Role


def role_in(caller: StaffCaller, study_id: uuid.UUID) -> Role | None:
    """The caller's role in a study, or None."""
    return "owner" if caller.is_admin else caller.roles.get(study_id)


def visible_studies(caller: Caller) -> frozenset[uuid.UUID] | None:
    """The studies whose data the called route may show to this caller; None: all. A phone has its own."""
    if isinstance(caller, DeviceCaller):
        return frozenset({caller.study_id})
    if caller.is_admin:
        return None
    return frozenset(study for study, role in caller.roles.items() if _reaches(role, caller.needs))


def known_studies(caller: Caller) -> frozenset[uuid.UUID] | None:
    """The studies that exist for this caller, whatever their role there; None: all."""
    if isinstance(caller, DeviceCaller):
        return frozenset({caller.study_id})
    return None if caller.is_admin else frozenset(caller.roles)


def require_study(caller: Caller, study_id: uuid.UUID, what: str = "study") -> None:
    """Let the caller into a study, or raise: NotFoundError where it is not theirs, NotAllowedError for a lower role."""
    if isinstance(caller, DeviceCaller):
        if caller.study_id != study_id:
            raise NotFoundError(f"There is no such {what}.")
        return
    role = role_in(caller, study_id)
    if role is None:
        raise NotFoundError(f"There is no such {what}.")
    if not _reaches(role, caller.needs):
        raise NotAllowedError(
            f"This needs the role {caller.needs} in the study; you are {role}.", code="role_too_low", needs=caller.needs
        )


def _reaches(role: Role, needed: Role) -> bool:
    return ROLES.index(role) >= ROLES.index(needed)
