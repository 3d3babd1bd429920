"""The conversation of a phone with a server: docs/apps.md."""

import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from json import dumps
from pathlib import Path
from secrets import token_urlsafe
from typing import Literal, cast, overload

from tada_client import schemas
from tada_client.caller import Caller, Filter, path_of
from tada_client.errors import Problem
from tada_client.pieces import is_large, send_in_pieces

Photograph = Path | bytes  # a file as the camera wrote it; a path is read while it is sent
Id = uuid.UUID | str
OnMeal = Callable[[schemas.MealOut], object]

UPLOAD_SECONDS = 60.0  # until a silent connection is given up
WAIT_SECONDS = 25.0  # longer ones are cut off by many networks
ROUNDS = 3  # of sending what the server lacks, also what it accepted and lost before it was durable
SHORTEST_ROUND_SECONDS = 1.0  # where something between phone and server answers a wait at once
FINAL = frozenset({"estimated", "needs_review", "failed", "confirmed"})
AFTER_FINAL = frozenset({"estimated", "needs_review", "failed", "nothing_left"})


class Phone(Caller):
    """A participant's phone. Each method is one call of the API, or a few that belong together."""

    def enrol(self, enrolment: schemas.EnrolmentIn) -> schemas.EnrolmentOut:
        """Exchange a one-time code for a token, which this client then uses. Keep `token` of the answer.

        If the answer is lost, a call with the same `secret` gets the same token. By default a secret is drawn for this
        call and its repeats; a program that may end in between draws it and keeps it before it calls.
        """
        body: schemas.EnrolmentIn = {"secret": token_urlsafe(), **enrolment}
        enrolled: schemas.EnrolmentOut
        try:
            enrolled = self.call("POST", "/v1/enrolments", json=body)
        except Problem as problem:
            unknown = {"at": "body.secret", "type": "extra_forbidden"}
            errors = cast(list[dict[str, str]], problem.document.get("errors", []))
            if not any(unknown.items() <= error.items() for error in errors):
                raise
            del body["secret"]  # a server that knows no secrets has not used the code
            enrolled = self.call("POST", "/v1/enrolments", json=body)
        self.token = enrolled["token"]
        return enrolled

    def get_server(self) -> schemas.ServerOut:
        """Return what the server can do; needs no token."""
        return cast(schemas.ServerOut, self.call("GET", "/v1/server"))

    def get_me(self) -> schemas.MeOut:
        """Return the participant, the study's protocol and this phone."""
        return cast(schemas.MeOut, self.call("GET", "/v1/me"))

    def sign_out(self) -> None:
        """Sign this phone out. What it sent is kept. A token that is no longer valid counts as signed out."""
        try:
            self.call("DELETE", "/v1/me/device")
        except Problem as problem:
            if problem.code != "unauthenticated":
                raise
        self.token = None

    def withdraw(self) -> schemas.ReceiptOut:
        """Leave the study: from now on every call is refused with `withdrawn`. Keep the receipt's id.

        Called again, because the answer was lost, it gets the same receipt.
        """
        return self._erase("POST", "/v1/me/withdrawal", "withdrawn")

    def get_receipt(self, receipt: Id) -> schemas.ReceiptOut:
        """Return a receipt again; needs no token."""
        return cast(schemas.ReceiptOut, self.call("GET", path_of("receipts", receipt)))

    def download_my_export(self, target: Path) -> Path:
        """Save all data about the participant, a ZIP file."""
        return self.download("/v1/me/export", target)

    def check_pair(
        self, left: bytes, right: bytes, metadata: schemas.CheckMetadataIn | None = None
    ) -> schemas.CheckOut:
        """Say whether this pair is good enough. Nothing is kept."""
        files = {
            name: (f"{name}.jpg", content, "image/jpeg")
            for name, content in (("left", left), ("right", right))
        }
        if metadata is not None:
            files["metadata"] = ("metadata.json", dumps(metadata).encode(), "application/json")
        return cast(
            schemas.CheckOut, self.call("POST", "/v1/checks", files=files, seconds=UPLOAD_SECONDS)
        )

    def send_meal(
        self,
        meal_id: Id,
        metadata: schemas.MealMetadataIn,
        photographs: Mapping[str, Photograph],
        on_progress: OnMeal | None = None,
    ) -> schemas.MealOut:
        """Send a meal part by part: its metadata, then the photographs that the server lacks.

        The same again continues where it broke off. Delete a photograph only once `meal["images"][slot]["durable"]`.
        meal_id: a UUID, made once per meal and kept with it. photographs: by slot. on_progress: called after each
        answer. Raises KeyError for a slot that the server waits for and `photographs` lacks.
        """
        meal = self.put_meal(meal_id, metadata)
        return self._send_missing(meal, lambda meal: meal["missing"], photographs, on_progress)

    def send_after(
        self,
        meal_id: Id,
        metadata: schemas.AfterMetadataIn,
        photographs: Mapping[str, Photograph],
        on_progress: OnMeal | None = None,
    ) -> schemas.MealOut:
        """Send what was left of a meal: when it was taken, then `after_left` and `after_right`, as `send_meal` does."""
        meal: schemas.MealOut = self.call("PUT", path_of("meals", meal_id, "after"), json=metadata)
        return self._send_missing(
            meal,
            lambda meal: meal["after"]["missing"] if meal["after"] is not None else [],
            photographs,
            on_progress,
        )

    def put_meal(self, meal_id: Id, metadata: schemas.MealMetadataIn) -> schemas.MealOut:
        """Announce a meal; the answer's `missing` lists what is to be sent."""
        return cast(schemas.MealOut, self.call("PUT", path_of("meals", meal_id), json=metadata))

    def put_photograph(self, meal_id: Id, slot: str, photograph: Photograph) -> schemas.MealOut:
        """Send one photograph of an announced meal, as often as needed.

        A large one goes in pieces, if the server takes them: after a cut connection, also in a later call, only the
        bytes that it lacks are sent. Always send the same bytes for a slot: a slot that has others refuses them with
        Problem `meal_id_reused`.
        """
        if is_large(photograph):
            meal = send_in_pieces(self, meal_id, slot, photograph, seconds=UPLOAD_SECONDS)
            if meal is not None:
                return meal
        path = path_of("meals", meal_id, "images", slot)
        return cast(
            schemas.MealOut, self.call("PUT", path, file=photograph, seconds=UPLOAD_SECONDS)
        )

    def declare_meal(self, meal: schemas.DeclaredMealIn) -> schemas.MealOut:
        """Enter a meal without photographs."""
        return cast(schemas.MealOut, self.call("POST", "/v1/declared-meals", json=meal))

    @overload
    def get_meal(self, meal_id: Id) -> schemas.MealOut: ...
    @overload
    def get_meal(
        self, meal_id: Id, known_version: int, wait_seconds: float = 0
    ) -> schemas.MealOut | None: ...
    def get_meal(
        self, meal_id: Id, known_version: int | None = None, wait_seconds: float = 0
    ) -> schemas.MealOut | None:
        """Return how a meal stands; None: it is still at known_version, also after waiting up to 60 s for a change."""
        headers = {"If-None-Match": f'"{known_version}"'} if known_version is not None else {}
        query = {"wait": wait_seconds} if wait_seconds else None
        seconds = self.seconds + wait_seconds
        answer = self.call(
            "GET", path_of("meals", meal_id), query=query, headers=headers, seconds=seconds
        )
        return cast(schemas.MealOut | None, answer)

    def wait_for_estimate(
        self, meal_id: Id, pair: Literal["meal", "after"] = "meal", on_change: OnMeal | None = None
    ) -> schemas.MealOut:
        """Return the meal once its estimate, or its after-meal pair's, has ended: also if it has failed.

        on_change: called at the beginning and after each change, to show `status` and `stage`.
        """
        meal = self.get_meal(meal_id)
        while True:
            if on_change is not None:
                on_change(meal)
            after = meal["after"]["status"] if meal["after"] is not None else None
            if meal["status"] in FINAL if pair == "meal" else after in AFTER_FINAL:
                return meal
            changed = None
            while changed is None:
                begun = time.monotonic()
                changed = self.get_meal(meal_id, meal["version"], WAIT_SECONDS)
                if changed is None:
                    time.sleep(max(0.0, SHORTEST_ROUND_SECONDS - (time.monotonic() - begun)))
            meal = changed

    def list_meals(self, **filters: Filter) -> Iterator[schemas.MealListItem]:
        """Yield the participant's meals by time of capture. filters: of GET /v1/meals, such as order="oldest"."""
        yield from self.rows("/v1/meals", filters)

    def delete_meal(self, meal_id: Id) -> schemas.ReceiptOut:
        """Erase a meal for good. Its id cannot be used again. Called again, it gets the same receipt."""
        return self._erase("DELETE", path_of("meals", meal_id), "meal_deleted")

    def cancel_estimate(self, meal_id: Id) -> schemas.MealOut:
        """Cancel an estimate that is not made yet: the meal fails with `cancelled`."""
        return cast(schemas.MealOut, self.call("POST", path_of("meals", meal_id, "cancel")))

    def download_photograph(
        self, meal_id: Id, slot: str, target: Path, width: int | None = None
    ) -> Path:
        """Save a photograph of a meal; width: reduced to at most so many pixels."""
        return self.download(
            path_of("meals", meal_id, "images", slot), target, query={"width": width}
        )

    def download_artefact(
        self, meal_id: Id, name: str, target: Path, pair: Literal["meal", "after"] = "meal"
    ) -> Path:
        """Save a picture, the points or the scene of a meal's last run; name: as the run lists it."""
        return self.download(
            path_of("meals", meal_id, "artefacts", name), target, query={"pair": pair}
        )

    def send_event(self, meal: schemas.MealOut, event: Mapping[str, object]) -> schemas.MealOut:
        """Confirm, correct, add or answer: `{"kind": "confirm", "item": item["id"]}`; docs/review.md lists all events.

        Raises Problem `precondition_failed` if the meal has changed since it was read. To send an event again later,
        give it an `id` of its own and keep that.
        """
        path, headers = path_of("meals", meal["id"], "events"), {"If-Match": f'"{meal["version"]}"'}
        event = {"id": str(uuid.uuid4()), **event}
        return cast(schemas.MealOut, self.call("POST", path, json=event, headers=headers))

    def get_questions(self) -> list[schemas.QuestionOut]:
        """Return the questions of reviewers that wait for an `answer` event."""
        return cast(list[schemas.QuestionOut], self.call("GET", "/v1/me/questions")["items"])

    def search_foods(self, words: str, limit: int | None = None) -> list[schemas.FoodMatch]:
        """Return foods by words of their names, best match first."""
        answer = self.call("GET", "/v1/foods", query={"q": words, "limit": limit})
        return cast(list[schemas.FoodMatch], answer["items"])

    def get_food(self, key: str) -> schemas.FoodOut:
        """Return one food with its figures."""
        return cast(schemas.FoodOut, self.call("GET", path_of("foods", key)))

    def get_vessels(self) -> list[schemas.PhoneVesselOut]:
        """Return the study's vessels, for a hint's `vessel`."""
        return cast(list[schemas.PhoneVesselOut], self.call("GET", "/v1/me/vessels")["items"])

    def get_days(self, from_: str | None = None, to: str | None = None) -> list[schemas.DayOut]:
        """Return the days with a meal or an entry; without a range, the last month. from_, to: such as 2026-11-21."""
        answer = self.call("GET", "/v1/me/days", query={"from": from_, "to": to})
        return cast(list[schemas.DayOut], answer["items"])

    def put_day(self, date: str, version: int, entry: schemas.DayIn) -> schemas.DayOut:
        """Close a day, say that nothing was eaten, or open it again. version: as it was read; 0: it was not listed."""
        headers = {"If-Match": f'"{version}"'}
        return cast(
            schemas.DayOut,
            self.call("PUT", path_of("me", "days", date), json=entry, headers=headers),
        )

    def get_summary(self, date: str | None = None) -> schemas.SummaryOut:
        """Return a day in figures and sentences. Raises Problem `feedback_off` where the study gives no feedback."""
        return cast(schemas.SummaryOut, self.call("GET", "/v1/me/summary", query={"date": date}))

    def get_reminders(self) -> schemas.RemindersOut:
        """Return this phone's reminders by Web Push, and the server's key to subscribe with."""
        return cast(schemas.RemindersOut, self.call("GET", "/v1/me/reminders"))

    def put_reminders(self, reminders: schemas.RemindersIn) -> schemas.RemindersOut:
        """Subscribe to reminders, or change when they come. Raises Problem `reminders_off`."""
        return cast(schemas.RemindersOut, self.call("PUT", "/v1/me/reminders", json=reminders))

    def delete_reminders(self) -> None:
        """Stop reminding this phone."""
        self.call("DELETE", "/v1/me/reminders")

    def _erase(self, method: str, path: str, code_of_erased: str) -> schemas.ReceiptOut:
        """Return an erasure's receipt, also if the answer was lost and the repeat is refused because it is done."""
        try:
            return cast(schemas.ReceiptOut, self.call(method, path))
        except Problem as problem:
            if problem.code != code_of_erased or "receipt" not in problem.document:
                raise
            return self.get_receipt(str(problem.document["receipt"]))

    def _send_missing(
        self,
        meal: schemas.MealOut,
        missing_of: Callable[[schemas.MealOut], list[str]],
        photographs: Mapping[str, Photograph],
        on_progress: OnMeal | None,
    ) -> schemas.MealOut:
        for _ in range(ROUNDS):
            for slot in missing_of(meal):
                if on_progress is not None:
                    on_progress(meal)
                meal = self.put_photograph(meal["id"], slot, photographs[slot])
        if on_progress is not None:
            on_progress(meal)
        return meal
