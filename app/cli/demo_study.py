"""`tada demo --browse`: a sample study on a throwaway server, served to a browser until Ctrl-C.

Created over HTTP as phones and staff do it: `make_study` creates people, `photograph_meals` uploads
photographed meals, `declare_days` fills the days with meals entered as text, `settle` waits for the
estimates of the photographs and sends the events of participants and reviewers. All but ids and
passwords is drawn from a seed.
"""

import io
import random
import secrets
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta
from zoneinfo import ZoneInfo

import httpx2
from PIL import Image

from app.cli.demo import (
    MARKER,
    PEOPLE,
    PLATES,
    SAMPLE,
    Person,
    Plate,
    bundled_photograph,
    checked,
    client_of,
    enrol,
    meal_of,
    say,
    send_event,
    serve_until_interrupted,
    upload,
)
from app.people.access.staff_schemas import SessionIssued
from app.records.meal_schemas import MealOut

STUDY = "sample"
ZONE = "Europe/Vienna"
HOME = (48.2082, 16.3738)  # degrees; the study keeps two decimals
SPREAD_DEGREES = 0.06
ADMIN = "admin"  # of the server, not of a study: corrects foods
ROLES = {"olga": "owner", "rene": "reviewer", "vera": "viewer", "ada": ADMIN}
DAYS = 14
AMOUNT_UNKNOWN = 0.01  # share of the declared foods without an amount, which then need review
AFTER_MINUTES = 40
PLATE_HOUR = 12.25  # local hour of the first of three photographed meals, one hour apart
WAIT_SECONDS = 25
SETTLE_SECONDS = 900


@dataclass(frozen=True, slots=True)
class Account:
    """A staff account with its password."""

    name: str
    role: str
    password: str


@dataclass(frozen=True, slots=True)
class Photographed:
    """A photographed meal.

    names: the phone names each food. then: the event that follows the estimate.
    """

    plate: Plate
    names: bool = False
    then: str | None = None  # confirm | ask
    is_cropped: bool = False  # the marker is cut off
    is_half: bool = False  # the right photograph never arrives
    days_ago: int = 0


PHOTOGRAPHED = tuple(
    Photographed(**meal | {"plate": PLATES[meal["plate"]]}) for meal in SAMPLE["photographed"]
)


@dataclass(slots=True)
class SampleStudy:
    """The created study.

    measured: meals that a worker has to estimate, each with the phone that sent it.
    """

    accounts: list[Account]
    people: list[Person]
    phones: dict[str, httpx2.Client]
    measured: list[tuple[Photographed, uuid.UUID, httpx2.Client]] = field(default_factory=list)

    def close(self) -> None:
        """Close the phones' connections."""
        for phone in self.phones.values():
            phone.close()


def browse_demo(seed: int, port: int) -> int:
    """Run the demo and return the exit status. port 0: any free one."""
    return serve_until_interrupted(port, lambda admin: _browse(admin, seed))


def _browse(admin: httpx2.Client, seed: int) -> None:
    """Fill the server, print its address, and wait to be interrupted."""
    study = make_study(admin)
    try:
        photograph_meals(study, seed)
        say(f"Open {str(admin.base_url).rstrip('/')}/dashboard/studies/{STUDY}")
        for account in study.accounts:
            print(f"   {account.role:<9} {account.name:<6} password {account.password}")
        say("Phones send photographed meals and fill days; the pages show the progress.")
        declare_days(study, seed)
        say("Two weeks of days of six participants are entered.")
        rene = next(account for account in study.accounts if account.role == "reviewer")
        session = checked(
            admin.post("/v1/sessions", json={"name": rene.name, "password": rene.password})
        )
        with client_of(
            admin.base_url, SessionIssued.model_validate_json(session.content).token
        ) as reviewer:
            meals_by_status = settle(study, reviewer)
        measured = ", ".join(
            f"{count} {status}" for status, count in sorted(meals_by_status.items())
        )
        say(f"Photographed meals are measured: {measured}; one waits for its other photograph.")
    finally:
        study.close()


def make_study(admin: httpx2.Client, people: Sequence[Person] = PEOPLE) -> SampleStudy:
    """Create a study with its staff and phones. admin: a client with an admin's token.

    Raises SystemExit with the server's message if it refuses a request, as all functions here do.
    """
    checked(
        admin.post(
            "/v1/studies",
            json={
                "code": STUDY,
                "name": "Sample study",
                "marker": MARKER,
                "location_policy": "round",
                "location_decimals": 2,
                "gives_feedback": True,
                "withdrawal_policy": "keep",
            },
        )
    )
    for vessel in SAMPLE["vessels"]:
        checked(admin.post(f"/v1/studies/{STUDY}/vessels", json=vessel))
    accounts = [make_account(admin, name, role) for name, role in ROLES.items()]
    phones = {
        person.code: enrol(admin, STUDY, {"code": person.code, "profile": person.profile})
        for person in people
    }
    return SampleStudy(accounts, list(people), phones)


def photograph_meals(
    study: SampleStudy, seed: int, meals: Sequence[Photographed] = PHOTOGRAPHED
) -> None:
    """Upload these meals, participants taking turns, and add them to `study.measured`."""
    chance = random.Random(seed)  # noqa: S311  draws places of meals, nothing secret
    today = datetime.now(ZoneInfo(ZONE)).date()
    for number, meal in enumerate(meals):
        phone = study.phones[study.people[number % len(study.people)].code]
        meal_id = send_photographs(phone, meal, today, number, chance)
        if not meal.is_half:
            study.measured.append((meal, meal_id, phone))


def declare_days(study: SampleStudy, seed: int, days: int = DAYS) -> None:
    """Enter each participant's meals of the last days as text, the newest last."""
    chance = random.Random(seed)  # noqa: S311  draws meals, nothing secret
    today = datetime.now(ZoneInfo(ZONE)).date()
    for ago in range(days - 1, -1, -1):
        for person in study.people:
            declare_day(
                study.phones[person.code],
                person,
                today - timedelta(days=ago),
                chance,
                is_over=ago > 0,
            )


def make_account(admin: httpx2.Client, name: str, role: str) -> Account:
    """Create an account with this role in the study, or an admin, and a random password."""
    password = secrets.token_urlsafe(12)
    checked(
        admin.post(
            "/v1/staff", json={"name": name, "password": password, "is_admin": role == ADMIN}
        )
    )
    if role != ADMIN:
        checked(admin.put(f"/v1/studies/{STUDY}/members/{name}", json={"role": role}))
    return Account(name, role, password)


def declare_day(
    phone: httpx2.Client, person: Person, day: date, chance: random.Random, *, is_over: bool
) -> None:
    """Enter a participant's meals of a day as text, and close the day with their probability."""
    declared = 0
    for meal in SAMPLE["occasions"]:
        dish, is_kept = chance.choice(meal["dishes"]), chance.random() < person.keeps
        at = instant(day, meal["hour"] + chance.uniform(-0.6, 0.6))
        if not is_kept or at > datetime.now(ZoneInfo(ZONE)):
            continue
        items = []
        for food, grams in dish.items():
            amount = {"mass_g": round(grams * person.appetite * chance.uniform(0.75, 1.25))}
            is_known = chance.random() >= AMOUNT_UNKNOWN
            items.append({"food": food} | ({"amount": amount} if is_known else {}))
        checked(phone.post("/v1/declared-meals", json=occasion(at, chance) | {"items": items}))
        declared += 1
    if is_over and declared and chance.random() < person.keeps:
        checked(
            phone.put(f"/v1/me/days/{day}", headers={"If-Match": '"0"'}, json={"status": "closed"})
        )


def occasion(at: datetime, chance: random.Random) -> dict[str, object]:
    """Return metadata of a new meal: id, time and place."""
    places = [round(degrees + chance.gauss(0, SPREAD_DEGREES), 5) for degrees in HOME]
    return {
        "id": str(uuid.uuid4()),
        "captured_at": at.isoformat(timespec="seconds"),
        "time_zone": ZONE,
        "location": {"latitude": places[0], "longitude": places[1]},
    }


def instant(day: date, hour: float) -> datetime:
    """Return this hour of a day in the study's time zone."""
    return datetime(day.year, day.month, day.day, tzinfo=ZoneInfo(ZONE)) + timedelta(hours=hour)


def send_photographs(
    phone: httpx2.Client, meal: Photographed, today: date, number: int, chance: random.Random
) -> uuid.UUID:
    """Upload a meal's photographs, those after it too, and return its id."""
    at = min(
        instant(today - timedelta(days=meal.days_ago), PLATE_HOUR + number % 3),
        datetime.now(ZoneInfo(ZONE)) - timedelta(minutes=number + 1),
    )
    hints = [] if meal.is_cropped else hints_at(meal.plate.points, names=meal.names)
    metadata = occasion(at, chance) | {"hints": hints}
    path = f"/v1/meals/{metadata['id']}"
    if meal.is_half:
        checked(phone.put(path, json={key: metadata[key] for key in metadata if key != "id"}))
        send_part(phone, path, "left", photograph(meal, "left"))
        return uuid.UUID(str(metadata["id"]))
    meal_id = upload(
        phone, metadata, {side: photograph(meal, side) for side in ("left", "right")}
    ).id
    if meal.plate.left_over:
        after = at + timedelta(minutes=AFTER_MINUTES)
        hints = hints_at(meal.plate.left_over, names=True)
        checked(
            phone.put(
                f"{path}/after",
                json={"captured_at": after.isoformat(timespec="seconds"), "hints": hints},
            )
        )
        for slot in ("after_left", "after_right"):
            send_part(phone, path, slot, photograph(meal, slot))
    return meal_id


def hints_at(points: Mapping[str, list[int]], *, names: bool) -> list[dict[str, object]]:
    """Return a hint per food. names: name the food too."""
    return [{"point": at} | ({"food": food} if names else {}) for food, at in points.items()]


def send_part(phone: httpx2.Client, path: str, slot: str, content: bytes) -> None:
    """Upload one photograph."""
    checked(
        phone.put(f"{path}/images/{slot}", content=content, headers={"Content-Type": "image/jpeg"})
    )


def photograph(meal: Photographed, slot: str) -> bytes:
    """Return a bundled photograph; of a cropped meal its right half, without the marker."""
    content = bundled_photograph(meal.plate.folder, slot)
    if not meal.is_cropped:
        return content
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(content)) as image:
        image.crop((image.width // 2, 0, image.width, image.height)).save(
            buffer, "JPEG", quality=90
        )
    return buffer.getvalue()


def settle(study: SampleStudy, reviewer: httpx2.Client) -> dict[str, int]:
    """Wait for the estimates, send the events that follow, and return the number of meals by status.

    Raises SystemExit if a meal is not estimated in time.
    """
    deadline, meals_by_status = time.monotonic() + SETTLE_SECONDS, dict[str, int]()
    for photographed, meal_id, phone in study.measured:
        meal = wait_for(phone, meal_id, deadline, is_after=bool(photographed.plate.left_over))
        if photographed.then == "confirm":
            for item in meal.items:
                send_event(phone, meal_id, kind="confirm", item=str(item.id))
        elif photographed.then == "ask":
            send_event(
                reviewer, meal_id, kind="question", text="Was there anything on the doughnut?"
            )
            send_event(phone, meal_id, kind="comment", text="Only the glaze that is on it.")
        status = meal_of(phone.get(f"/v1/meals/{meal_id}")).status
        meals_by_status[status] = meals_by_status.get(status, 0) + 1
    return meals_by_status


def wait_for(
    phone: httpx2.Client, meal_id: uuid.UUID, deadline: float, *, is_after: bool
) -> MealOut:
    """Return the meal once its estimate has ended. is_after: wait for its after-meal pair too."""
    while time.monotonic() < deadline:
        meal = meal_of(phone.get(f"/v1/meals/{meal_id}", params={"wait": WAIT_SECONDS}))
        statuses = {
            meal.status,
            meal.after.status if is_after and meal.after is not None else "estimated",
        }
        if not statuses & {"queued", "processing", "receiving"}:
            return meal
    raise SystemExit(f"tada: meal {meal_id} was not estimated in {SETTLE_SECONDS} s")
