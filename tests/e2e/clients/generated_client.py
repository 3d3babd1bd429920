"""A phone's conversation by a client that was generated from our OpenAPI document; see test_clients.py, which runs it.

python generated_client.py FOLDER_OF_THE_CLIENT SERVER ADMIN_TOKEN OPENAPI_JSON PHOTOGRAPHS
"""

import datetime as dt
import importlib
import json
import pathlib
import sys
import uuid

STUDY = "generated-python"


def part(name):
    return importlib.import_module(f"phone_client.{name}")


def require_every_operation(document):
    for methods in document["paths"].values():
        for operation in methods.values():
            module = part(f"api.{operation['tags'][0].replace(' ', '_')}.{operation['operationId']}")
            assert module.sync_detailed, operation["operationId"]


def talk(address, token, photographs):
    models = part("models")
    strict = {"base_url": address, "raise_on_unexpected_status": True, "timeout": 90.0}
    with part("client").AuthenticatedClient(token=token, **strict) as admin:
        code = set_up_study(admin)
        with part("client").Client(**strict) as anybody:
            enrolment = models.EnrolmentIn(code=code, device_name="generated")
            token = part("api.enrolments.post_enrolment").sync(client=anybody, body=enrolment).token
        with part("client").AuthenticatedClient(token=token, **strict) as phone:
            send_and_confirm_a_meal(phone, photographs)
            (record,) = part("api.records.get_records").sync(client=admin, study=STUDY).items
            assert (record.food.key, record.status) == ("apple", "confirmed"), record
            assert part("api.privacy.post_my_withdrawal").sync(client=phone).what == "participant"


def set_up_study(admin):
    """A study with a participant; the participant's enrolment code."""
    models = part("models")
    study = models.StudyIn(code=STUDY, name="Generated", marker="plain:9x7:11")
    assert part("api.studies.post_study").sync(client=admin, body=study).code == STUDY
    person = models.ParticipantIn(code="P001")
    part("api.participants.post_participant").sync(STUDY, client=admin, body=person)
    return part("api.participants.post_enrolment_code").sync(STUDY, "P001", client=admin).code


def send_and_confirm_a_meal(phone, photographs):
    models, types = part("models"), part("types")
    meal_id = uuid.uuid4()
    metadata = models.MealMetadataIn(
        captured_at=dt.datetime(2026, 11, 20, 12, 30, tzinfo=dt.UTC),
        time_zone="Europe/London",
        hints=[models.HintIn(point=[1092.0, 620.0], food="apple")],
    )
    assert part("api.meals.put_meal").sync(meal_id, client=phone, body=metadata).missing == ["left", "right"]
    slots = models.PutPhotographSlot
    for slot, name in ((slots.LEFT, "left.jpg"), (slots.RIGHT, "right.jpg")):
        with (photographs / name).open("rb") as photograph:
            body = types.File(payload=photograph)
            meal = part("api.meals.put_photograph").sync(meal_id, slot, client=phone, body=body)
    assert all(image.durable for image in meal.images.additional_properties.values())
    for _ in range(40):
        meal = part("api.meals.get_meal").sync(meal_id, client=phone, wait=25.0)
        if meal.status in {"estimated", "needs_review", "failed"}:
            break
    assert (meal.status, meal.items[0].food.key) == ("estimated", "apple"), meal
    confirm = models.ConfirmIn(id=uuid.uuid4(), item=meal.items[0].id, kind="confirm")
    events = part("api.review.post_event")
    meal = events.sync(meal_id, client=phone, body=confirm, if_match=f'"{meal.version}"')
    assert meal.status == "confirmed", meal
    problem = part("api.meals.get_meal").sync(uuid.uuid4(), client=phone)
    assert (problem.code, problem.retryable) == ("not_found", False), problem
    etag = f'"{meal.version}"'
    unchanged = part("api.meals.get_meal").sync_detailed(meal_id, client=phone, if_none_match=etag)
    assert (unchanged.status_code, unchanged.headers["ETag"]) == (304, etag)


if __name__ == "__main__":
    folder, address, token, document, photographs = sys.argv[1:]
    sys.path.insert(0, folder)
    require_every_operation(json.loads(pathlib.Path(document).read_text()))
    talk(address, token, pathlib.Path(photographs))
