"""Phones: each sends its meals over HTTP until it is told that both photographs are durable, as an app would.

In one request, part by part, the same from two sides at once, broken off in the middle, slowly. What was acknowledged
is written down here and nowhere else: the checker compares it with database and store.
"""

import hashlib
import itertools
import json
import threading
import time
import uuid
from dataclasses import dataclass, field
from datetime import UTC, datetime

import httpx2

from tests.e2e.faults.pictures import Note, photograph, volumes_ml

WAYS = ("whole", "parts", "twice", "cut", "slowly")
PIECES = 4  # of a body that is sent slowly
SECONDS = 6.0  # that a phone waits for an answer
HINTS = [{"point": [20 * number + 10, 30], "food": "apple"} for number in range(3)]


@dataclass(frozen=True)
class Planned:
    """A meal as the phone has it. photos by slot. expects: its failure code, or None; volumes of its items, or None."""

    meal_id: uuid.UUID
    photos: dict
    way: str
    hints: list
    expects: str | None = None
    volumes_ml: list | None = None
    after: dict = field(default_factory=dict)
    is_erased: bool = False

    @property
    def metadata(self):
        told = {"captured_at": "2026-11-20T12:30:00+08:00", "time_zone": "Asia/Shanghai", "hints": self.hints}
        return told | {"app_version": "faults"}


def plan_meals(rng, count, real_pair):
    """Meals of all ways, drawn; the first is of the real pair, if any, the second crashes the decoder."""
    meals = []
    for number in range(count):
        meal_id = uuid.UUID(int=rng.getrandbits(128), version=4)
        way = WAYS[number % len(WAYS)]
        if number % 50 == 0 and real_pair is not None:
            hints = [{"point": [1092, 620], "food": "apple"}]
            meals.append(Planned(meal_id, dict(real_pair), way, hints))
            continue
        note = Note(seconds=round(rng.uniform(0.3, 2.5), 2), items=rng.randint(1, 3), crashes=number % 15 == 1)
        photos = {slot: photograph(rng, note) for slot in ("left", "right")}
        after = {}
        if number % 6 == 2:
            left_over = Note(seconds=round(rng.uniform(0.1, 0.8), 2), items=1)
            after = {slot: photograph(rng, left_over) for slot in ("after_left", "after_right")}
        meals.append(
            Planned(
                meal_id,
                photos,
                way,
                HINTS[: note.items],
                "estimate_crashed" if note.crashes else None,
                None if note.crashes else volumes_ml(photos["left"], photos["right"], note.items),
                after,
                is_erased=number % 9 == 4,
            )
        )
    return meals


def plan_slow_meal(rng, seconds):
    """A meal in one request whose estimate takes so long that its worker can be killed at it."""
    photos = {slot: photograph(rng, Note(seconds=seconds)) for slot in ("left", "right")}
    volumes = volumes_ml(photos["left"], photos["right"], 1)
    return Planned(uuid.UUID(int=rng.getrandbits(128), version=4), photos, "whole", HINTS[:1], volumes_ml=volumes)


class Journal:
    """What all phones were told, and when the last good answer came."""

    def __init__(self, timeline):
        self._timeline = timeline.open("a", buffering=1)
        self._lock = threading.Lock()
        self._last_good = time.monotonic()
        self.longest_without_answer = 0.0
        self.tries = 0
        self.good_answers = 0
        self.acknowledged = {}
        self.after_acknowledged = set()
        self.erased = set()
        self.refused = []

    def good(self):
        with self._lock:
            now = time.monotonic()
            self.longest_without_answer = max(self.longest_without_answer, now - self._last_good)
            self._last_good = now
            self.good_answers += 1

    def close(self):
        self._timeline.close()

    def tried(self):
        with self._lock:
            self.tries += 1

    def note(self, words):
        """Into the timeline, which stands beside the logs: for whoever looks for the cause of a failure."""
        self._timeline.write(f"{datetime.now(UTC):%H:%M:%S.%f} {words}\n")


class BrokenOffError(Exception):
    """The phone lost its network in the middle of a body."""


class Phone(threading.Thread):
    """One participant's phone with its meals. addresses: of all servers; it takes another when one does not answer.

    progress(): how much of the storm has been, 0 to 1. The meals are spread over it; in between the phone asks how the
    last one stands, as apps do.
    """

    def __init__(self, code, token, addresses, meals, journal, rng, progress):
        super().__init__(name=f"phone {code}", daemon=True)
        self.code = code
        self._headers = {"Authorization": f"Bearer {token}"}
        self._addresses = addresses
        self._meals = meals
        self._journal = journal
        self._rng = rng
        self._progress = progress
        self.deadline = None
        self.trouble = None

    def run(self):
        try:
            asked_for = None
            for place, meal in enumerate([*self._meals, None]):
                while self._progress() < place / len(self._meals):
                    if asked_for is not None:
                        self._until(lambda client, one=asked_for: self._ask(client, one), f"how {asked_for} stands")
                    time.sleep(self._rng.uniform(0.1, 0.6))
                if meal is not None:
                    self.send(meal)
                    asked_for = asked_for if meal.is_erased else meal.meal_id
        except Exception as error:  # noqa: BLE001  # told by the test in its own thread
            self.trouble = error

    def send(self, meal):
        way = {"parts": self._by_parts, "twice": self._twice}.get(meal.way, self._whole)
        self._until(lambda client: way(client, meal), f"meal {meal.meal_id} ({meal.way})")
        self._journal.acknowledged[meal.meal_id] = (self.code, meal)
        if meal.after:
            self._until(lambda client: self._photos(client, meal, meal.after), f"after-meal pair of {meal.meal_id}")
            self._journal.after_acknowledged.add(meal.meal_id)
        if meal.is_erased:
            self._until(lambda client: self._erase(client, meal), f"erasure of {meal.meal_id}")
            self._journal.erased.add(meal.meal_id)

    def _until(self, attempt, what):
        try:
            self._try_until(attempt, what)
        except AssertionError as error:
            self._journal.note(f"{self.code} {what}: {error}")
            raise

    def _try_until(self, attempt, what):
        for number in itertools.count(1):
            if time.monotonic() > self.deadline:
                raise AssertionError(f"{what}: no answer in time, after {number} tries")
            self._journal.tried()
            address, began = self._rng.choice(self._addresses), time.monotonic()
            try:
                with httpx2.Client(base_url=address, headers=self._headers, timeout=SECONDS) as client:
                    answer = "yes" if attempt(client) else "later"
            except (httpx2.HTTPError, BrokenOffError) as error:
                answer = type(error).__name__
            side = self._addresses.index(address)
            self._journal.note(f"{self.code} {what} at {side}: {answer} in {time.monotonic() - began:.1f} s")
            if answer == "yes":
                return
            time.sleep(self._rng.uniform(0.1, 0.4))

    def _whole(self, client, meal):
        """One request; the first time it may break off in the middle, or go slowly."""
        files = {"metadata": ("m", json.dumps(meal.metadata | {"id": str(meal.meal_id)}).encode(), "application/json")}
        files |= {slot: (slot, content, "image/jpeg") for slot, content in meal.photos.items()}
        request = client.build_request("POST", "/v1/meals", files=files)
        body = request.read()
        way = meal.way if self._rng.random() < 0.5 else "whole"
        if way == "whole":
            return self._is_durable(client.send(request), meal.photos)
        headers = {"Content-Type": request.headers["Content-Type"], "Content-Length": str(len(body))}
        answer = client.post("/v1/meals", content=self._pieces(body, breaks_off=way == "cut"), headers=headers)
        return self._is_durable(answer, meal.photos)

    def _pieces(self, body, *, breaks_off):
        size = len(body) // PIECES + 1
        for number in range(PIECES):
            if breaks_off and number == PIECES // 2:
                raise BrokenOffError
            yield body[number * size : (number + 1) * size]
            time.sleep(0.1)

    def _by_parts(self, client, meal):
        if not self._is_kept(client.put(f"/v1/meals/{meal.meal_id}", json=meal.metadata)):
            return False
        return self._photos(client, meal, meal.photos)

    def _photos(self, client, meal, photos):
        for slot, content in photos.items():
            path = f"/v1/meals/{meal.meal_id}/images/{slot}"
            answer = client.put(path, content=content, headers={"Content-Type": "image/jpeg"})
            if not self._is_kept(answer):
                return False
        return self._is_durable(answer, photos)

    def _twice(self, client, meal):
        """The same from another side at the same time, as by a phone that changes its network."""

        def other_side():
            address = self._addresses[-1]
            try:
                with httpx2.Client(base_url=address, headers=self._headers, timeout=SECONDS) as second:
                    self._whole(second, meal)
            except httpx2.HTTPError:
                pass
            except AssertionError as error:
                self._journal.refused.append(str(error))

        beside = threading.Thread(target=other_side)
        beside.start()
        try:
            return self._whole(client, meal)
        finally:
            beside.join()

    def _ask(self, client, meal_id):
        """What was acknowledged is there, at whatever server."""
        return self._is_kept(client.get(f"/v1/meals/{meal_id}"))

    def _erase(self, client, meal):
        answer = client.delete(f"/v1/meals/{meal.meal_id}")
        if answer.status_code == 410:  # the answer to the try before was lost
            assert answer.json()["code"] == "meal_deleted", answer.text
            self._journal.good()
            return True
        return self._is_kept(answer)

    def _is_kept(self, answer):
        if answer.status_code < 300:
            self._journal.good()
            return True
        problem = answer.json()
        self._journal.note(f"{self.code}: {answer.status_code} {problem.get('code')}")
        assert problem["retryable"], f"refused for good: {answer.status_code} {answer.text}"
        return False

    def _is_durable(self, answer, photos):
        if not self._is_kept(answer):
            return False
        told = answer.json()
        images = told["images"] | (told["after"] or {"images": {}})["images"]
        for slot, content in photos.items():
            assert images[slot]["received_sha256"] == hashlib.sha256(content).hexdigest()
            assert images[slot]["durable"] is True
        return True
