"""A record as NutritionIntake, a participant as Patient: rows in, JSON out.

A NutritionIntake is one record, the food of one item of a meal: its nutrients are the food's own, its figures are those
of /v1/records, and nothing is summed over foods of which one could not be measured. Unknown values are left out or have
a `data-absent-reason`; they are never 0. docs/fhir.md describes each element.
"""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone
from urllib.parse import urlencode

from pydantic import JsonValue

from app.core.units import content_of_mass
from app.extras.fhir.answers import outcome_issue
from app.extras.fhir.names import (
    ABSENT,
    ABSENT_CODES,
    FOOD_DATA_CENTRAL,
    TIME_ZONE,
    UCUM,
    Names,
    Resource,
    patient_id,
)
from app.extras.fhir.queries import IntakeRow
from app.extras.fhir.search import CURSOR, SearchQuery
from app.foods.models import Component as FoodComponent
from app.http.paging import Page
from app.meals.stored.record_models import EffectiveRecord
from app.nutrition.components import COMPONENT_BY_NUMBER, HEADLINES, Component
from app.people.models import Participant
from app.records.queries import RecordRow

UCUM_CODES = {"g": "g", "mg": "mg", "ug": "ug", "kcal": "kcal", "kJ": "kJ", "IU": "[iU]"}
FOOD_SYSTEMS = {"sr28_ndb": "usda-ndb", "fndds": "usda-fndds", "foodex2": "efsa-foodex2"}
INTERVAL, RECORD_STATUS, REVIEWED = (
    f"StructureDefinition/{name}" for name in ("interval-90", "record-status", "reviewed")
)
NOT_NEGATIVE_FOOD = (
    "More was left than was served, within the error of both; "
    "it is not set to 0, which would bias means."
)


class Intakes:
    """Makes the resources of one server; nutrients are made once."""

    def __init__(self, names: Names) -> None:
        self._names = names
        self._nutrients: dict[str, Resource] = {}

    def resource(self, intake: IntakeRow) -> Resource:
        """Return the NutritionIntake of a record."""
        names, row, record = self._names, intake.row, intake.row.record
        local = timezone(timedelta(minutes=row.utc_offset_minutes))
        resource: Resource = {
            "resourceType": "NutritionIntake",
            "id": str(record.item_id),
            "meta": {"versionId": str(record.change_seq)},
            "extension": [
                {"url": names.url(RECORD_STATUS), "valueCode": record.status},
                {"url": names.url(REVIEWED), "valueBoolean": record.reviewed},
            ],
            "identifier": [{"system": names.system("items"), "value": str(record.item_id)}],
            "partOf": [
                {
                    "type": "NutritionIntake",
                    "identifier": {
                        "system": names.meals(row.study_code, row.participant_code),
                        "value": str(row.meal_client_id),
                    },
                    "display": "The meal",
                }
            ],
            "status": status_of(record),
            "subject": subject_of(names, row.study_code, row.participant_code),
            "occurrenceDateTime": _instant(record.captured_at, local),
            "_occurrenceDateTime": {"extension": [{"url": TIME_ZONE, "valueCode": row.time_zone}]},
            "recorded": _instant(row.received_at, UTC),
            **self._reported(row),
            "consumedItem": [
                {
                    "type": {"text": "Food or drink"},
                    "nutritionProduct": {"concept": self._food(intake)},
                    "amount": self._amount(record),
                }
            ],
        }
        if labels := list[JsonValue](self._labels(intake)):
            resource["ingredientLabel"] = labels
        if notes := list[JsonValue](_notes(record)):
            resource["note"] = notes
        return resource

    def _reported(self, row: RecordRow) -> Resource:
        """Return the source: the participant for declared items; whether a person added it for the others."""
        if row.record.origin == "declared":
            return {
                "reportedReference": subject_of(self._names, row.study_code, row.participant_code)
            }
        return {"reportedBoolean": row.record.origin == "added"}

    def _food(self, intake: IntakeRow) -> Resource:
        food = intake.food
        if food is None:
            unknown: Resource = {"system": ABSENT_CODES, "code": "unknown", "display": "Unknown"}
            return {"coding": [unknown], "text": "A food that is not identified yet"}
        name, release = _text(food.name), _text(intake.row.food_release)
        version = release if food.version == 1 else f"{release}, version {food.version}"
        codings: list[JsonValue] = [
            {
                "system": self._names.system("foods"),
                "version": version,
                "code": _text(food.key),
                "display": name,
            }
        ]
        if food.source_ids.get("fdc_id"):
            codings.append({"system": FOOD_DATA_CENTRAL, "code": _text(food.source_ids["fdc_id"])})
        codings += [
            {"system": self._names.system(system), "code": _text(food.source_ids[source])}
            for source, system in FOOD_SYSTEMS.items()
            if food.source_ids.get(source)
        ]
        return {"coding": codings, "text": name}

    def _amount(self, record: EffectiveRecord) -> Resource:
        if record.consumed_g is None:
            return {"extension": [{"url": ABSENT, "valueCode": "unknown"}]}
        amount = quantity(record.consumed_g, "g")
        if record.consumed_low_g is not None and record.consumed_high_g is not None:
            low, high = quantity(record.consumed_low_g, "g"), quantity(record.consumed_high_g, "g")
            amount["extension"] = [
                {"url": self._names.url(INTERVAL), "valueRange": {"low": low, "high": high}}
            ]
        return amount

    def _labels(self, intake: IntakeRow) -> Iterator[Resource]:
        """Yield all components with a figure; the headline components have the record's figures."""
        record = intake.row.record
        if record.consumed_g is None:
            return
        amounts: dict[str, tuple[FoodComponent | Component, float]] = {}
        for nutrient in intake.nutrients:
            per_g = content_of_mass(nutrient.per_100_g, 1.0)
            amounts[nutrient.component.number] = nutrient.component, record.consumed_g * per_g
        for headline in HEADLINES:
            numbers, value = headline.numbers, getattr(record, headline.column)
            if value is not None:
                number = next((number for number in numbers if number in amounts), numbers[0])
                component, _ = amounts.get(number, (COMPONENT_BY_NUMBER[number], value))
                amounts[number] = component, value
        for component, amount in amounts.values():
            yield {
                "nutrient": self._nutrient(component),
                "amount": quantity(amount, component.unit),
            }

    def _nutrient(self, component: FoodComponent | Component) -> Resource:
        number, tagname, name = component.number, component.tagname, component.name
        if number not in self._nutrients:
            codings: list[JsonValue] = []
            if tagname is not None:
                codings.append({"system": self._names.system("infoods-tagnames"), "code": tagname})
            # USDA's; a component without such a number is identified by its tagname
            if number.isdecimal():
                codings.append({"system": self._names.system("usda-nutrients"), "code": number})
            concept: Resource = {"coding": codings} if codings else {}
            self._nutrients[number] = {"concept": concept | {"text": name}}
        return self._nutrients[number]


def patient(names: Names, participant: Participant, study_code: str) -> Resource:
    """Return a participant as a Patient: the code in a study, and whether the participant is still in it."""
    return {
        "resourceType": "Patient",
        "id": patient_id(study_code, participant.code),
        "identifier": [_identifier(names, study_code, participant.code)],
        "active": participant.withdrawn_at is None,
    }


def subject_of(names: Names, study_code: str, participant_code: str) -> Resource:
    """Return a reference to a participant."""
    logical_id = patient_id(study_code, participant_code)
    reference: Resource = {"reference": f"Patient/{logical_id}"} if logical_id is not None else {}
    return reference | {
        "type": "Patient",
        "identifier": _identifier(names, study_code, participant_code),
    }


def status_of(record: EffectiveRecord) -> str:
    """Return the state of the intake, not of its review: in progress while an after-meal pair may still come."""
    return "in-progress" if record.provisional else "completed"


def quantity(value: float, unit: str) -> Resource:
    """Return a Quantity. unit: one of app/core/units.py."""
    return {"value": value, "unit": unit, "system": UCUM, "code": UCUM_CODES[unit]}


def search_bundle(names: Names, query: SearchQuery, page: Page[IntakeRow]) -> Resource:
    """Return the bundle, without a total, which would require counting all matches."""
    intakes, here = Intakes(names), names.url("NutritionIntake")
    links: list[JsonValue] = [{"relation": "self", "url": _url(here, query.used, query.cursor)}]
    if page.cursor is not None:
        links.append({"relation": "next", "url": _url(here, query.used, page.cursor)})
    entries: list[JsonValue] = [
        {
            "fullUrl": f"{here}/{intake.row.record.item_id}",
            "resource": intakes.resource(intake),
            "search": {"mode": "match"},
        }
        for intake in page.rows
    ]
    if query.ignored:
        entries.append({"resource": _ignored(names, query.ignored), "search": {"mode": "outcome"}})
    bundle: Resource = {"resourceType": "Bundle", "type": "searchset", "link": links}
    return bundle | ({"entry": entries} if entries else {})


def _ignored(names: Names, parameters: tuple[str, ...]) -> Resource:
    system = names.system("errors")
    text = "Ignored, since it is not supported here: {}. GET /fhir/metadata lists the supported parameters."
    return {
        "resourceType": "OperationOutcome",
        "issue": [
            outcome_issue(
                "warning",
                "not-supported",
                "search_parameter_unsupported",
                system,
                text.format(name),
            )
            for name in parameters
        ],
    }


def _url(here: str, used: tuple[tuple[str, str], ...], cursor: str | None) -> str:
    query = urlencode([*used, *([(CURSOR, cursor)] if cursor is not None else [])])
    return f"{here}?{query}" if query else here


def _identifier(names: Names, study_code: str, participant_code: str) -> Resource:
    return {"system": names.participants(study_code), "value": participant_code}


def _notes(record: EffectiveRecord) -> Iterator[Resource]:
    if record.consumed_g is None:
        yield {"text": "The eaten amount is unknown: count it as missing, not as 0."}
    elif record.consumed_g < 0:
        yield {"text": NOT_NEGATIVE_FOOD}
    for flag in record.flags:
        yield {"text": f"Flag: {flag}"}


def _instant(instant: datetime, zone: timezone) -> str:
    return instant.astimezone(zone).isoformat().replace("+00:00", "Z")


def _text(value: object) -> str:
    """Return text as FHIR's codes and strings require: no leading, trailing or repeated spaces."""
    return " ".join(str(value).split())
