"""Addresses of the dashboard's pages. Every part is quoted: people choose codes and names freely."""

from urllib.parse import quote

from app.people.access.page_rules import PREFIX


def study_address(study: str, *parts: object) -> str:
    """Return the address of a study's page. parts: path segments below the study, such as "participants", "P001"."""
    return "/".join([f"{PREFIX}/studies", *[quote(str(part), safe="") for part in (study, *parts)]])
