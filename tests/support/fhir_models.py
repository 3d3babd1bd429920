"""What is served as FHIR, read by a FHIR library: R5 models, which refuse what they do not know."""

import json
from decimal import Decimal

from fhir.resources import get_fhir_model_class
from fhir.resources.bundle import Bundle

TAGNAMES = {
    "energy_kcal": "ENERC_KCAL", "protein_g": "PROCNT", "fat_g": "FAT", "carbohydrate_g": "CHOCDF", "fibre_g": "FIBTG",
    "sugar_g": "SUGAR", "saturated_fat_g": "FASAT", "sodium_mg": "NA", "potassium_mg": "K", "vitamin_c_mg": "VITC",
}  # fmt: skip


def valid(answer, status=200):
    """The body of an answer, which must be a valid resource and come out of the library as it went in."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"].split(";")[0] == "application/fhir+json"
    body = answer.json()
    model = get_fhir_model_class(body["resourceType"]).model_validate_json(answer.text)
    assert json.loads(model.model_dump_json(), parse_float=Decimal) == json.loads(answer.text, parse_float=Decimal)
    return body


def bundle(answer):
    """The resources that match, of a searchset."""
    body = valid(answer)
    Bundle.model_validate_json(answer.text)
    assert body["type"] == "searchset"
    return [entry["resource"] for entry in body.get("entry", ()) if entry["search"]["mode"] == "match"]


def error_of(answer):
    """(status, code) of an OperationOutcome."""
    issue = valid(answer, answer.status_code)["issue"][0]
    assert (issue["severity"], answer.status_code >= 400) == ("error", True)
    return answer.status_code, issue["details"]["coding"][0]["code"]


def link(answer, relation):
    """The URL of a bundle's link, or None."""
    return next((one["url"] for one in answer.json()["link"] if one["relation"] == relation), None)


def labels(resource):
    """Tagname or USDA's number -> (amount, UCUM code)."""
    found = {}
    for label in resource.get("ingredientLabel", ()):
        for coding in label["nutrient"]["concept"].get("coding", ()):
            found[coding["code"]] = (label["amount"]["value"], label["amount"]["code"])
    return found
