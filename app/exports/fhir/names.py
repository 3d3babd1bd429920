"""Names in FHIR: this server's URLs, its systems of identifiers and codes, and the ids of Patients.

A Patient's id is made of codes alone, STUDY.CODE, so that no further name of a person is made that would outlive the
code's being taken away (docs/decisions/0016). FHIR's ids know no underscore: it is written as two dots; a code begins
with a letter or digit and has no dot, so that it can be read back.
"""

import re
from dataclasses import dataclass

from fastapi import Request

from app.core.settings import Settings
from app.exports.fhir.fhir_intakes import PersonName

PATIENT_ID = re.compile(r"[A-Za-z0-9\-.]{1,64}")  # the datatype `id`
CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
OF_STUDY = re.compile(r"(?:(?P<study>[A-Za-z0-9][A-Za-z0-9_-]{0,63})\.)?(?P<code>[A-Za-z0-9][A-Za-z0-9_-]{0,63})")

UCUM = "http://unitsofmeasure.org"
ABSENT = "http://hl7.org/fhir/StructureDefinition/data-absent-reason"
ABSENT_CODES = "http://terminology.hl7.org/CodeSystem/data-absent-reason"
EVENT_STATUS = "http://hl7.org/fhir/event-status"
TIME_ZONE = "http://hl7.org/fhir/StructureDefinition/timezone"
FOOD_DATA_CENTRAL = "https://fdc.nal.usda.gov/"  # as the standard's own examples of NutritionProduct have it


@dataclass(frozen=True, slots=True)
class Names:
    """base: where /fhir is, without a slash at the end."""

    base: str

    def url(self, path: str) -> str:
        """Of a resource or an extension's definition."""
        return f"{self.base}/{path}"

    def system(self, name: str) -> str:
        """Of identifiers or codes of ours."""
        return f"{self.base}/sid/{name}"

    def participants(self, study_code: str) -> str:
        """The system of a study's participant codes."""
        return self.system(f"studies/{study_code}/participants")

    def meals(self, study_code: str, participant_code: str) -> str:
        """The system of a participant's meals: a phone makes their ids, so they are unique for the participant only."""
        return self.system(f"studies/{study_code}/participants/{participant_code}/meals")


def names_of(request: Request) -> Names:
    """Names as callers outside know them: by TADA_PUBLIC_URL, or else as the caller wrote the host."""
    settings: Settings = request.app.state.settings
    return Names((settings.public_url or str(request.base_url)).rstrip("/") + "/fhir")


def patient_id(study_code: str, participant_code: str) -> str | None:
    """A Patient's id; None where it would be longer than FHIR allows: then the identifier alone names them."""
    found = f"{study_code}.{participant_code}".replace("_", "..")
    return found if PATIENT_ID.fullmatch(found) else None


def person_of_id(found: str) -> PersonName | None:
    """Whom an id names: STUDY.CODE, or CODE alone; None: nobody."""
    named = OF_STUDY.fullmatch(found.replace("..", "_"))
    return PersonName(named["study"], named["code"]) if named is not None else None


def person_of_token(names: Names, token: str) -> PersonName | None:
    """Whom `system|code` names: the system is a study's, or just its code; None: nobody."""
    system, bar, code = token.rpartition("|")
    if CODE.fullmatch(code) is None:
        return None
    if not system:
        return None if bar else PersonName(None, code)  # "|code" asks for an identifier without a system: none of ours
    head, _, tail = names.participants("|").partition("|")
    study = system[len(head) : -len(tail)] if system.startswith(head) and system.endswith(tail) else system
    return PersonName(study, code) if CODE.fullmatch(study) else None
