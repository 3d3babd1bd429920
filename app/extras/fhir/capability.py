"""The server's CapabilityStatement, and the StructureDefinitions of its own extensions."""

from dataclasses import dataclass

from app import __version__
from app.extras.fhir.names import Names, Resource
from app.extras.fhir.search import MOST_COUNT

FHIR_VERSION = "5.0.0"
DEFINED = "2026-11-22"  # when these definitions last changed

PERSON = (
    "Whose: Patient/STUDY.CODE, or Patient/CODE if only one study has such a participant. Several, separated by "
    "commas: of any of them."
)
SEARCH_PARAMETERS = (
    ("_id", "token", "Ids of NutritionIntakes, separated by commas."),
    ("identifier", "token", "The same as _id, with or without the system."),
    (
        "subject",
        "reference",
        f"{PERSON} With :identifier, by the system and code of subject.identifier.",
    ),
    ("patient", "reference", "The same as subject."),
    (
        "date",
        "date",
        (
            "When it was eaten; if repeated, all must be met. Prefixes: eq, ge, le, gt, lt, sa, eb. A year, month or "
            "day is of the participant's own calendar (with the study's start of the day); a time must have an offset."
        ),
    ),
    (
        "status",
        "token",
        "completed, or in-progress: an after-meal pair may still show what was left.",
    ),
)


@dataclass(frozen=True, slots=True)
class Extension:
    """An extension of this server. on: the element that has it; value: the type of its value[x]."""

    name: str
    title: str
    on: str
    value: str
    meaning: str


EXTENSIONS = (
    Extension(
        "interval-90",
        "Interval at 90 percent",
        "NutritionIntake.consumedItem.amount",
        "Range",
        "The interval that contains the true amount with a probability of 90 percent. Amounts of nutrients are "
        "proportional to this amount, and so are their intervals; the food table's own uncertainty is not included.",
    ),
    Extension(
        "record-status",
        "Status of the record",
        "NutritionIntake",
        "code",
        "How certain food and amount are: proposed (by the server, not reviewed), needs_review (the food or the "
        "amount is unknown), confirmed or corrected (by a person).",
    ),
    Extension(
        "reviewed",
        "Reviewed",
        "NutritionIntake",
        "boolean",
        "Whether a reviewer of the study made the last decision.",
    ),
)


def capability_statement(names: Names) -> Resource:
    """Return the resource of GET /fhir/metadata."""
    return {
        "resourceType": "CapabilityStatement",
        "url": names.url("metadata"),
        "version": __version__,
        "name": "TadaServer",
        "title": "tada-server",
        "status": "active",
        "date": DEFINED,
        "kind": "instance",
        "software": {"name": "tada-server", "version": __version__},
        "implementation": {
            "description": "Records of image-based dietary assessment, read only",
            "url": names.base,
        },
        "fhirVersion": FHIR_VERSION,
        "format": ["json"],
        "rest": [
            {
                "mode": "server",
                "documentation": "Records that count, as NutritionIntake: one per food of a meal. Unknown parameters "
                "are ignored, and named in the bundle; `Prefer: handling=strict` refuses them. There is no total. "
                f"Pages of up to {MOST_COUNT}, in the order of `date`; follow `next`.",
                "security": {
                    "cors": False,
                    "description": "Authorization: Bearer TOKEN. Staff see their studies, a phone its participant. "
                    "Anything else is not found.",
                },
                "resource": [
                    {
                        "type": "NutritionIntake",
                        "documentation": "Rejected records are excluded; by id they are gone (410). versionId grows "
                        "with every change of the record; its time is not stored, so there is no lastUpdated.",
                        "interaction": [{"code": "read"}, {"code": "search-type"}],
                        "versioning": "versioned",
                        "readHistory": False,
                        "searchParam": [
                            {"name": name, "type": kind, "documentation": documentation}
                            for name, kind, documentation in SEARCH_PARAMETERS
                        ],
                    },
                    {
                        "type": "Patient",
                        "documentation": "A participant: a code in a study, without personal data.",
                        "interaction": [{"code": "read"}],
                        "versioning": "no-version",
                    },
                    {
                        "type": "StructureDefinition",
                        "documentation": f"Of this server's extensions: {', '.join(each.name for each in EXTENSIONS)}.",
                        "interaction": [{"code": "read"}],
                        "versioning": "no-version",
                    },
                ],
            }
        ],
    }


def structure_definition(names: Names, extension: Extension) -> Resource:
    """Return the resource of GET /fhir/StructureDefinition/{name}."""
    url = names.url(f"StructureDefinition/{extension.name}")
    description: Resource = {"short": extension.title, "definition": extension.meaning}
    return {
        "resourceType": "StructureDefinition",
        "id": extension.name,
        "url": url,
        "version": __version__,
        "name": "".join(word.capitalize() for word in extension.name.split("-")),
        "title": extension.title,
        "status": "active",
        "date": DEFINED,
        "description": extension.meaning,
        "fhirVersion": FHIR_VERSION,
        "kind": "complex-type",
        "abstract": False,
        "context": [{"type": "element", "expression": extension.on}],
        "type": "Extension",
        "baseDefinition": "http://hl7.org/fhir/StructureDefinition/Extension",
        "derivation": "constraint",
        "differential": {
            "element": [
                {"id": "Extension", "path": "Extension", "min": 0, "max": "1", **description},
                {"id": "Extension.extension", "path": "Extension.extension", "max": "0"},
                {"id": "Extension.url", "path": "Extension.url", "fixedUri": url},
                {
                    "id": "Extension.value[x]",
                    "path": "Extension.value[x]",
                    "min": 1,
                    "type": [{"code": extension.value}],
                },
            ]
        },
    }
