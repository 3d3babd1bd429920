"""A meal with an after-meal pair: sent by a phone, measured as a test says."""

from tests.integration.conftest import meal_metadata
from tests.support import estimates
from tests.support.photographs import pair, photograph

RED, YELLOW, WHITE = (45.0, 50.0, 30.0), (80.0, 5.0, 65.0), (88.0, 0.0, 12.0)
HINTS = [{"point": [30, 20], "food": "apple"}, {"point": [60, 20], "food": "banana"}]


def apple(volume_ml=185.0, **changes):
    return estimates.seen_item(-60, 100, RED, volume_ml, **({"hint": 0} | changes))


def banana(volume_ml=155.0, **changes):
    return estimates.seen_item(50, 110, YELLOW, volume_ml, **({"hint": 1} | changes))


def left_of_apple(volume_ml=100.0, **changes):
    return estimates.seen_item(-55, 96, RED, volume_ml, **changes)


def left_of_banana(volume_ml=120.0, **changes):
    return estimates.seen_item(54, 105, YELLOW, volume_ml, **changes)


class Table:
    """One meal of a phone."""

    def __init__(self, phone, state, seed=0, **metadata):
        self.phone, self.state = phone, state
        self.metadata = meal_metadata(**({"hints": HINTS} | metadata))
        self.id = self.metadata["id"]
        assert phone.post(pair(seed), self.metadata).status_code == 202

    def get(self, **params):
        answer = self.phone.get(f"/v1/meals/{self.id}", **params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    @property
    def after(self):
        return self.get()["after"]

    def record(self, food):
        rows = self.phone.get("/v1/records").json()["items"]
        return next(row for row in rows if row["meal_id"] == self.id and row["food"]["key"] == food)

    def put(self, slot, content=None, seed=None):
        seed = {"after_left": 71, "after_right": 72}[slot] if seed is None else seed
        return self.phone.put(
            f"/v1/meals/{self.id}/images/{slot}",
            content=content if content is not None else photograph(seed),
            headers={"Content-Type": "image/jpeg"},
        )

    def tell(self, **body):
        return self.phone.put(f"/v1/meals/{self.id}/after", json={"captured_at": "2026-11-20T12:55:00+08:00"} | body)

    def measured(self, *items, **changes):
        estimates.save(
            self.state, self.id, *(items or (() if "failure" in changes else (apple(), banana()))), **changes
        )
        return self

    def send_after(self):
        for slot in ("after_left", "after_right"):
            answer = self.put(slot)
            assert answer.status_code == 202, answer.text
        return self

    def after_measured(self, *items, **changes):
        estimates.save(self.state, self.id, *items, purpose="after", **changes)
        return self

    def ate(self, *left, **changes):
        """Measured before and after, with these pieces left."""
        return self.measured().send_after().after_measured(*left, **changes)
