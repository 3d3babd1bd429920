"""Three days of meals about which people have said this and that, by seed: what must agree is compared over them."""

import random
import uuid

import pytest
import sqlalchemy as sa

from app.people.models import Study
from tests.integration.diary.eaten_days import set_profile
from tests.integration.records.after_pairs import Table, apple, banana, left_of_apple, left_of_banana
from tests.integration.records.reviewing import Speaker, new_event
from tests.support.estimates import unmeasured_item
from tests.support.filled_databases import fill_once

WOMAN = {"sex": "female", "birth_year": 1990, "weight_kg": 60.0}
FOODS = ("pear", "milk-whole", "bread-white", "apple-gala", "durian", "fruit-salad")


class Chatter:
    """Says what comes to mind of a meal, by seed; what is refused is refused."""

    def __init__(self, rng, phone, reviewer):
        self.rng, self.speakers = rng, (phone, reviewer)
        self.said = []

    def say(self):
        rng = self.rng
        speaker = rng.choice(self.speakers)
        meal = speaker.meal()
        items = [item["id"] for item in meal["items"] if not {"replaced", "undone"} & set(item["flags"])]
        pieces = [piece["id"] for piece in (meal["after"] or {}).get("leftovers", [])]
        item = rng.choice(items) if items else str(uuid.uuid4())
        amount = rng.choice([None, {"mass_g": 80.0}, {"mass_g": 30.0, "of": "edible"}, {"volume_ml": 120.0}])
        event = rng.choice(
            [
                lambda: new_event("confirm", item=item),
                lambda: new_event("reject", item=item),
                lambda: new_event("set_food", item=item, food=rng.choice(FOODS)),
                lambda: new_event("set_mass", item=rng.choice([*items, *pieces] or [item]), mass_g=90.0),
                lambda: new_event("set_volume", item=rng.choice([*items, *pieces] or [item]), volume_ml=60.0),
                lambda: new_event("set_share", item=item, share=rng.choice([0.25, 0.5, 1.0])),
                lambda: new_event("split", item=item, parts=[{"share": 0.3}, {"share": 0.7, "food": "pear"}]),
                lambda: new_event("merge", items=rng.sample(items, min(2, len(items))), food="pear"),
                lambda: new_event("add", food=rng.choice(FOODS), amount=amount, share=rng.choice([0.5, 1.0])),
                lambda: new_event("set_leftover", item=rng.choice(pieces or [item]), of=item, **{"class": "food_left"}),
                lambda: new_event("nothing_left"),
                lambda: new_event("confirm_meal"),
                lambda: new_event("undo", event=rng.choice(self.said) if self.said else str(uuid.uuid4())),
            ]
        )()
        if speaker.send(event).status_code == 201:
            self.said.append(event["id"])


@pytest.fixture
def talked_over(phone, client, admin, state, request):
    """Three days of meals, some with leftovers, which the participant and a reviewer edit and confirm.

    They are made once per seed and copied (SQLite), with the photographs and the tokens of the phone and the admin.
    """
    folder = client.app.state.settings.data_dir

    def fill(_database):
        """Return the headers of the phone and of the admin, and the files by their path in the data folder."""
        _talk(random.Random(request.param), phone, client, admin, state)
        files = {path.relative_to(folder): path.read_bytes() for path in folder.glob("blobs/**/*") if path.is_file()}
        return (dict(phone.headers), dict(admin)), files

    tokens, files = fill_once(state.database, fill, key=("talked over", request.param))
    for headers, kept in zip((phone.headers, admin), tokens, strict=True):
        headers.update(kept)
    for path, content in files.items():
        place = folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    return phone


def _talk(rng, phone, client, admin, state):
    with state.database.write() as session:
        session.execute(sa.update(Study).values(gives_feedback=True))
    set_profile(state, **WOMAN)
    for number in range(6):
        captured_at = f"2026-11-{17 + number // 2}T{8 + number:02}:30:00+08:00"
        table = Table(phone, state, seed=number, captured_at=captured_at)
        if rng.random() < 0.1:
            continue  # not measured yet
        table.measured(*rng.choice([(apple(), banana()), (apple(),), (apple(), unmeasured_item(hint=1))]))
        if rng.random() < 0.6:
            table.send_after().after_measured(
                *rng.choice([(left_of_apple(), left_of_banana(60.0)), (left_of_apple(200.0),)])
            )
        chatter = Chatter(rng, Speaker(client, phone.headers, table.id), Speaker(client, admin, table.id))
        for _ in range(rng.randrange(6)):
            chatter.say()
    drink = {"food": "milk-whole", "amount": {"volume_ml": 250}, "share": 0.5}
    body = {"id": str(uuid.uuid4()), "captured_at": "2026-11-18T16:00:00+08:00", "time_zone": "Asia/Shanghai"}
    answer = client.post("/v1/declared-meals", headers=phone.headers, json=body | {"items": [drink]})
    assert answer.status_code == 201, answer.text
    for day in (17, 18, 19):
        phone.put(f"/v1/me/days/2026-11-{day}", json={"status": "closed"}, headers={"If-Match": "*"})
    phone.put("/v1/me/days/2026-11-16", json={"status": "closed", "ate_nothing": True}, headers={"If-Match": "*"})
