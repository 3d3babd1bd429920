"""Menu entries of a study and of the whole server, by role."""

from dataclasses import dataclass

from app.people.access.caller import reaches
from app.people.models import Role


@dataclass(frozen=True, slots=True)
class Entry:
    """A page: path below the study (or the dashboard), label, lowest role that may see it."""

    path: tuple[str, ...]
    label: str
    needs: Role = "viewer"


STUDY: tuple[Entry, ...] = (
    Entry((), "Overview"),
    Entry(("meals",), "Meals"),
    Entry(("review",), "Review", "reviewer"),
    Entry(("participants",), "Participants"),
    Entry(("intakes",), "Intakes"),
    Entry(("adequacy",), "Adequacy"),
    Entry(("exports",), "Exports"),
    Entry(("releases",), "Releases"),
    Entry(("remeasurements",), "Remeasurements"),
    Entry(("densities",), "Densities"),
    Entry(("vessels",), "Vessels"),
    Entry(("devices",), "Devices"),
    Entry(("members",), "Members", "owner"),
    Entry(("webhooks",), "Webhooks", "owner"),
    Entry(("audit",), "Audit log", "owner"),
    Entry(("settings",), "Settings"),
)
SERVER: tuple[Entry, ...] = (Entry(("foods",), "Foods"), Entry(("marker",), "Marker"), Entry(("account",), "Account"))
ADMIN: tuple[Entry, ...] = (Entry(("staff",), "Staff"), Entry(("audit",), "Audit log"))


def study_menu(role: Role | None) -> list[Entry]:
    """Return the study's pages that this role may see."""
    return [entry for entry in STUDY if reaches(role, entry.needs)]


def server_menu(*, is_admin: bool) -> list[Entry]:
    """Return the pages that belong to no study."""
    return [*SERVER, *(ADMIN if is_admin else ())]
