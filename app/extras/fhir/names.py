"""Names in FHIR: this server's URLs, its systems of identifiers and codes, and the ids of Patients.

A Patient's id consists of codes, STUDY.CODE, so that there is no further identifier that would outlive the code's
erasure (docs/decisions/0016). FHIR's ids allow no underscore: it is written as two dots. A code begins with a letter or
digit and has no dot, so that the id can be read back.
"""

import re
from dataclasses import dataclass

from fastapi import Request
from pydantic import JsonValue

from app.core.settings import Settings
from app.extras.fhir.fhir_intakes import PersonName

PATIENT_ID = re.compile(r"[A-Za-z0-9\-.]{1,64}")  # the datatype `id`
CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
OF_STUDY = re.compile(
    r"(?:(?P<study>[A-Za-z0-9][A-Za-z0-9_-]{0,63})\.)?(?P<code>[A-Za-z0-9][A-Za-z0-9_-]{0,63})"
)

UCUM = "http://unitsofmeasure.org"
ABSENT = "http://hl7.org/fhir/StructureDefinition/data-absent-reason"
ABSENT_CODES = "http://terminology.hl7.org/CodeSystem/data-absent-reason"
EVENT_STATUS = "http://hl7.org/fhir/event-status"
TIME_ZONE = "http://hl7.org/fhir/StructureDefinition/timezone"
# as in the standard's own examples of NutritionProduct
FOOD_DATA_CENTRAL = "https://fdc.nal.usda.gov/"

Resource = dict[str, JsonValue]


@dataclass(frozen=True, slots=True)
class Names:
    """base: the URL of /fhir, without a trailing slash."""

    base: str

    def url(self, path: str) -> str:
        """Return the URL of a resource or an extension's definition."""
        return f"{self.base}/{path}"

    def system(self, name: str) -> str:
        """Return the system of this server's identifiers or codes."""
        return f"{self.base}/sid/{name}"

    def participants(self, study_code: str) -> str:
        """Return the system of a study's participant codes."""
        return self.system(f"studies/{study_code}/participants")

    def meals(self, study_code: str, participant_code: str) -> str:
        """Return the system of a participant's meals, whose ids are unique per participant only: phones make them."""
        return self.system(f"studies/{study_code}/participants/{participant_code}/meals")


def names_of(request: Request) -> Names:
    """Return the names under TADA_PUBLIC_URL, or under the request's own host."""
    settings: Settings = request.app.state.settings
    return Names((settings.public_url or str(request.base_url)).rstrip("/") + "/fhir")


def patient_id(study_code: str, participant_code: str) -> str | None:
    """Return a Patient's id; None if it is longer than FHIR allows, so that only the identifier names the Patient."""
    logical_id = f"{study_code}.{participant_code}".replace("_", "..")
    return logical_id if PATIENT_ID.fullmatch(logical_id) else None


def person_of_id(logical_id: str) -> PersonName | None:
    """Return the participant of an id STUDY.CODE or CODE; None if it is no such id."""
    match = OF_STUDY.fullmatch(logical_id.replace("..", "_"))
    return PersonName(match["study"], match["code"]) if match is not None else None


def person_of_token(names: Names, token: str) -> PersonName | None:
    """Return the participant of `system|code`, where the system is a study's or just its code; None for others."""
    system, bar, code = token.rpartition("|")
    if CODE.fullmatch(code) is None:
        return None
    if not system:
        # "|code" is an identifier without a system: there is none
        return None if bar else PersonName(None, code)
    head, _, tail = names.participants("|").partition("|")
    study = (
        system[len(head) : -len(tail)]
        if system.startswith(head) and system.endswith(tail)
        else system
    )
    return PersonName(study, code) if CODE.fullmatch(study) else None
