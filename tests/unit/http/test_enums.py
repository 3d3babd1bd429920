"""Closed sets are enums in the OpenAPI document, so that a generated client has them too."""

import pytest

from app.exports.models import EXPORT_STATES
from app.exports.release_models import RELEASE_STATES
from app.http.text_schemas import stored_word
from app.meals.day_models import DAY_STATUSES
from app.meals.event_models import EVENT_KINDS, LAYERS
from app.meals.models import MEAL_ORIGINS, MEAL_STATUSES
from app.meals.record_models import ITEM_ORIGINS, RECORD_STATUSES
from app.nutrition.foods import FOOD_STATES
from app.outbox.models import DELIVERY_STATES
from app.people.models import ROLES

WORDS = (
    "status", "state", "kind", "origin", "layer", "role", "scope", "stage", "policy", "locale", "verdict", "event",
    "events", "basis", "form", "severity", "source", "found", "action", "class", "weighs", "unit", "method", "type",
    "life_stage", "per", "rows", "layout", "components", "needs", "slot", "what", "scale", "lies_as", "why_not",
    "decided_by", "plausibility", "answer",
)  # fmt: skip
ENDINGS = ("_status", "_state", "_kind", "_basis", "_policy")
OPEN = {  # (schema, field) -> why it is any text; a schema of "*": wherever the field stands
    ("*", "source"): "a publication or a person",
    ("*", "unit"): "the food table's, which grows with imports",
    ("*", "stage"): "a step of the pipeline, which a newer worker may name otherwise",
    ("*", "method"): "free text, or a run's, which older pipelines may have named otherwise",
    ("DensityIn", "state"): "free text, such as boiled, mashed",
    ("DensityOut", "state"): "free text, such as boiled, mashed",
    ("RejectedDensityOut", "state"): "free text, such as boiled, mashed",
    ("MeasuredDensityIn", "state"): "free text, such as boiled, mashed",
    ("StudyDensityIn", "state"): "free text, such as boiled, mashed",
    ("StudyDensityOut", "state"): "free text, such as boiled, mashed",
    ("AuditEventOut", "action"): "each kind of change has its own, and the log keeps those that are gone",
    ("Problem", "type"): "RFC 9457: a URI",
    ("Problem", "status"): "a number",
}


def is_any_text(schema):
    if schema.keys() & {"enum", "const", "$ref", "pattern", "format"}:
        return False
    if "anyOf" in schema:
        return any(map(is_any_text, schema["anyOf"]))
    if schema.get("type") == "array":
        return is_any_text(schema.get("items", {}))
    return schema.get("type") == "string"


def is_named_as_a_closed_set(name):
    return name in WORDS or name.endswith(ENDINGS)


def test_no_closed_set_is_any_text(document):
    fields = {
        (schema, name): field
        for schema, content in document["components"]["schemas"].items()
        for name, field in content.get("properties", {}).items()
        if is_named_as_a_closed_set(name)
    }
    assert len(fields) > 120
    any_text = {place for place, field in fields.items() if is_any_text(field)}
    assert {place for place in any_text if place not in OPEN and ("*", place[1]) not in OPEN} == set()


def test_no_parameter_of_a_closed_set_is_any_text(operations):
    any_text = {
        (path, parameter["name"])
        for (_, path), operation in operations.items()
        for parameter in operation.get("parameters", ())
        if is_named_as_a_closed_set(parameter["name"]) and is_any_text(parameter["schema"])
    }
    assert any_text == {
        ("/v1/audit", "action"),
        ("/v1/studies/{study}/audit", "action"),
        ("/fhir/NutritionIntake", "status"),  # FHIR's token: several codes, parted by commas
    }


@pytest.mark.parametrize(
    ("schema", "field", "words"),
    [
        ("MealOut", "status", MEAL_STATUSES),
        ("MealListItem", "origin", MEAL_ORIGINS),
        ("ItemOut", "status", RECORD_STATUSES),
        ("RecordOut", "origin", ITEM_ORIGINS),
        ("EventOut", "kind", EVENT_KINDS),
        ("EventOut", "layer", LAYERS),
        ("DayOut", "status", DAY_STATUSES),
        ("MemberOut", "role", ROLES),
        ("ExportOut", "state", EXPORT_STATES),
        ("ReleaseOut", "state", RELEASE_STATES),
        ("DeliveryOut", "state", DELIVERY_STATES),
    ],
)
def test_an_answer_has_all_words_that_the_database_lets_in(document, schema, field, words):
    assert document["components"]["schemas"][schema]["properties"][field]["enum"] == list(words)


def test_a_stored_word_that_this_version_does_not_know_is_null():
    assert stored_word("cooked", FOOD_STATES) == "cooked"
    assert stored_word("fermented", FOOD_STATES) is None
    assert stored_word(None, FOOD_STATES) is None
