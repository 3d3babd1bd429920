"""Menu entries of a study, in groups, and of the whole server, by role."""

from collections.abc import Mapping
from dataclasses import dataclass

from app.people.access.caller import reaches
from app.people.models import Role


@dataclass(frozen=True, slots=True)
class Entry:
    """A page: path below the study (or the dashboard), label, lowest role that may see it."""

    path: tuple[str, ...]
    label: str
    needs: Role = "viewer"


FOODS = Entry(("foods",), "Foods")  # of the whole server
STUDY: Mapping[str, tuple[Entry, ...]] = {
    "Data": (
        Entry((), "Overview"),
        Entry(("meals",), "Meals"),
        Entry(("review",), "Review", "reviewer"),
        FOODS,
    ),
    "People": (
        Entry(("participants",), "Participants"),
        Entry(("devices",), "Devices"),
        Entry(("enrol",), "Cards", "owner"),
    ),
    "Results": (
        Entry(("intakes",), "Intakes"),
        Entry(("adequacy",), "Adequacy"),
        Entry(("exports",), "Exports"),
        Entry(("releases",), "Releases"),
    ),
    "Setup": (
        Entry(("settings",), "Settings"),
        Entry(("members",), "Members", "owner"),
        Entry(("densities",), "Densities"),
        Entry(("vessels",), "Vessels"),
        Entry(("remeasurements",), "Remeasurements"),
        Entry(("webhooks",), "Webhooks", "owner"),
        Entry(("audit",), "Audit log", "owner"),
    ),
}
SERVER: tuple[Entry, ...] = (FOODS, Entry(("marker",), "Marker"), Entry(("account",), "Account"))
ADMIN: tuple[Entry, ...] = (Entry(("staff",), "Staff"), Entry(("audit",), "Audit log"))


def study_menu(role: Role | None) -> dict[str, list[Entry]]:
    """Return group -> the study's pages that this role may see."""
    return {
        group: [entry for entry in entries if reaches(role, entry.needs)]
        for group, entries in STUDY.items()
    }


def server_menu(*, is_admin: bool) -> list[Entry]:
    """Return the pages that belong to no study."""
    return [*SERVER, *(ADMIN if is_admin else ())]
