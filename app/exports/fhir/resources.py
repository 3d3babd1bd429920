"""A record as NutritionIntake, a participant as Patient: rows in, plain JSON out.

One NutritionIntake is one record, the food that one item of a meal is: so its nutrients are the food's own, its figures
are those of /v1/records, and nothing has to be summed over foods of which one could not be measured. What is not known
is not there, or says so by `data-absent-reason`; it is never 0. docs/fhir.md tells each element.
"""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

from app.core.units import content_of_mass
from app.exports.fhir.names import ABSENT, ABSENT_CODES, FOOD_DATA_CENTRAL, TIME_ZONE, UCUM, Names, patient_id
from app.exports.fhir.queries import FoodComponent, IntakeFood, IntakeRow
from app.foods.food_amounts import RECORD_COLUMNS
from app.meals.record_models import EffectiveRecord
from app.nutrition.components import COMPONENT_BY_NUMBER, Component
from app.people.models import Participant
from app.records.queries import RecordRow

Resource = dict[str, Any]

UCUM_CODES = {"g": "g", "mg": "mg", "ug": "ug", "kcal": "kcal", "kJ": "kJ", "IU": "[iU]"}
FOOD_SYSTEMS = {"sr28_ndb": "usda-ndb", "fndds": "usda-fndds", "foodex2": "efsa-foodex2"}
INTERVAL, RECORD_STATUS, REVIEWED = (
    f"StructureDefinition/{name}" for name in ("interval-90", "record-status", "reviewed")
)
NOT_NEGATIVE_FOOD = (
    "More was left than was served, within the error of both; it is not set to 0, which would bias means."
)


class Intakes:
    """Writes resources of one server; what is the same in all of them is made once."""

    def __init__(self, names: Names) -> None:
        self._names = names
        self._nutrients: dict[str, Resource] = {}

    def resource(self, intake: IntakeRow) -> Resource:
        """The NutritionIntake of a record."""
        names, row, record = self._names, intake.of, intake.of.record
        local = timezone(timedelta(minutes=row.utc_offset_minutes))
        found: Resource = {
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
                    "nutritionProduct": {"concept": self._food(intake.food)},
                    "amount": self._amount(record),
                }
            ],
        }
        labels = list(self._labels(record, intake.food))
        notes = list(_notes(record))
        return found | ({"ingredientLabel": labels} if labels else {}) | ({"note": notes} if notes else {})

    def _reported(self, row: RecordRow) -> Resource:
        """Declared: the participant told it. Added: somebody saw it in the photographs. Else it was measured there."""
        if row.record.origin == "declared":
            return {"reportedReference": subject_of(self._names, row.study_code, row.participant_code)}
        return {"reportedBoolean": row.record.origin == "added"}

    def _food(self, food: IntakeFood | None) -> Resource:
        if food is None:
            unknown = {"system": ABSENT_CODES, "code": "unknown", "display": "Unknown"}
            return {"coding": [unknown], "text": "A food that nobody has named yet"}
        name, release = _text(food.name), _text(food.release)
        version = release if food.version == 1 else f"{release}, version {food.version}"
        codings = [
            {"system": self._names.system("foods"), "version": version, "code": _text(food.key), "display": name}
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
        found = quantity(record.consumed_g, "g")
        if record.consumed_low_g is not None and record.consumed_high_g is not None:
            interval = {"low": quantity(record.consumed_low_g, "g"), "high": quantity(record.consumed_high_g, "g")}
            found["extension"] = [{"url": self._names.url(INTERVAL), "valueRange": interval}]
        return found

    def _labels(self, record: EffectiveRecord, food: IntakeFood | None) -> Iterator[Resource]:
        """All components that the food's version knows; the ten that a record holds itself are the record's figures."""
        if record.consumed_g is None:
            return
        amounts: dict[str, tuple[FoodComponent | Component, float]] = {
            component.number: (component, record.consumed_g * content_of_mass(per_100_g, 1.0))
            for component, per_100_g in (food.contents if food is not None else ())
        }
        for column, numbers in RECORD_COLUMNS.items():
            value = getattr(record, column)
            if value is not None:
                number = next((each for each in numbers if each in amounts), numbers[0])
                amounts[number] = (amounts[number][0] if number in amounts else COMPONENT_BY_NUMBER[number], value)
        for component, amount in amounts.values():
            yield {"nutrient": self._nutrient(component), "amount": quantity(amount, component.unit)}

    def _nutrient(self, component: FoodComponent | Component) -> Resource:
        number, tagname, name = component.number, component.tagname, component.name
        if number not in self._nutrients:
            codings = []
            if tagname is not None:
                codings.append({"system": self._names.system("infoods-tagnames"), "code": tagname})
            if number.isdecimal():  # USDA's; a component that it has no number for goes by its tagname
                codings.append({"system": self._names.system("usda-nutrients"), "code": number})
            self._nutrients[number] = {"concept": ({"coding": codings} if codings else {}) | {"text": name}}
        return self._nutrients[number]


def patient(names: Names, participant: Participant, study_code: str) -> Resource:
    """A participant: a code in a study, and whether they are still in it. Nothing else is known of the person here."""
    return {
        "resourceType": "Patient",
        "id": patient_id(study_code, participant.code),
        "identifier": [_identifier(names, study_code, participant.code)],
        "active": participant.withdrawn_at is None,
    }


def subject_of(names: Names, study_code: str, participant_code: str) -> Resource:
    """A reference to a participant."""
    found: Resource = {"type": "Patient", "identifier": _identifier(names, study_code, participant_code)}
    logical = patient_id(study_code, participant_code)
    return ({"reference": f"Patient/{logical}"} if logical is not None else {}) | found


def status_of(record: EffectiveRecord) -> str:
    """The state of the eating, not of its review: in progress as long as an after-meal pair may tell what was left."""
    return "in-progress" if record.provisional else "completed"


def quantity(value: float, unit: str) -> Resource:
    """A number of a unit of app/core/units.py."""
    return {"value": value, "unit": unit, "system": UCUM, "code": UCUM_CODES[unit]}


def _identifier(names: Names, study_code: str, participant_code: str) -> Mapping[str, str]:
    return {"system": names.participants(study_code), "value": participant_code}


def _notes(record: EffectiveRecord) -> Iterator[Resource]:
    if record.consumed_g is None:
        yield {
            "text": "How much was eaten could not be measured, and nobody has told it: count it as missing, not as 0."
        }
    elif record.consumed_g < 0:
        yield {"text": NOT_NEGATIVE_FOOD}
    for flag in record.flags:
        yield {"text": f"Flag: {flag}"}


def _instant(instant: datetime, zone: timezone) -> str:
    return instant.astimezone(zone).isoformat().replace("+00:00", "Z")


def _text(value: object) -> str:
    """As FHIR's codes and strings are: no space at the ends, none doubled."""
    return " ".join(str(value).split())
