"""Addresses of the dashboard's pages. Every part is quoted: codes and names are people's own words."""

from urllib.parse import quote

from app.people.access.page_rules import PREFIX


def study_address(study: str, *parts: object) -> str:
    """A page of a study: its code, then the parts below it, "participants", "P001"."""
    return "/".join([f"{PREFIX}/studies", *[quote(str(part), safe="") for part in (study, *parts)]])
