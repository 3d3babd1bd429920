"""Whole pages of the dashboard by HTTP: a server of its own on a filled database, a browser's cookie, page by page.

Which pages: every route of page_rules.py that answers HTML and whose address can be made from the database; files
and what needs other data (a webhook, an export) are told as not measured. The time is the client's, from the request
to the last byte of the answer: the server's, and the way through the loopback.
"""

import random
import re
import secrets
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import httpx2
import sqlalchemy as sa
from pydantic import SecretStr

from app.cli.demo import running_server
from app.core.settings import Settings
from app.db.session import Database
from app.meals.stored.models import Meal
from app.people.access.page_rules import PAGES
from app.people.access.passwords import Passwords
from app.people.access.staff import create_staff
from app.people.models import Participant, Study
from benchmarks.query_data import FIRST_DAY, FOODS, Shape, food_key

BROWSER = {"Accept": "text/html", "Sec-Fetch-Site": "same-origin"}
NO_LIMITS = {
    "staff_calls_per_minute": 0,
    "address_calls_per_minute": 0,
    "exports_per_minute": 0,
}
NOTHING_NEW = 204  # of a fragment that a page asks for again and again
MEALS_DRAWN = 200
WINDOW = 28  # days
SLOWEST_S = 120.0


@dataclass(frozen=True)
class PageCall:
    """A page by its route, or one of its views. address: drawn anew for each request."""

    name: str
    address: Callable[[], str]


def page_calls(
    database: Database, study: str, shape: Shape, chance: random.Random
) -> tuple[list[PageCall], list[str]]:
    """What can be asked of this database, and the routes of which no address can be made."""
    meals = drawn_meals(database, study, shape, chance)

    def values() -> dict[str, str]:
        participant, meal_id = chance.choice(meals)
        food = food_key(chance.randrange(FOODS))
        day = str(FIRST_DAY + timedelta(days=chance.randrange(shape.days)))
        return {
            "study": study,
            "participant": participant,
            "meal_id": str(meal_id),
            "key": food,
            "food": food,
            "day": day,
        }

    calls, left_out = [], []
    for method, route in PAGES:
        if method != "GET":
            continue
        if set(re.findall(r"{(\w+)(?::\w+)?}", route)) - values().keys():
            left_out.append(route)
        else:
            calls.append(PageCall(route, lambda route=route: route.format_map(values())))  # type: ignore[misc]
    calls.extend(
        PageCall(name, lambda view=view: view(values())) for name, view in views(shape, chance)
    )  # type: ignore[misc]
    return calls, left_out


def views(
    shape: Shape, chance: random.Random
) -> Iterator[tuple[str, Callable[[dict[str, str]], str]]]:
    """Pages by their filters, as people ask for them."""
    base = "/dashboard/studies/{study}"

    def window() -> str:
        first = FIRST_DAY + timedelta(days=chance.randrange(max(1, shape.days - WINDOW)))
        return f"from={first}&to={first + timedelta(days=WINDOW - 1)}"

    for name, query in (
        ("overview, 28 days anywhere", base + "?{window}"),
        ("overview, 90 days", base + "?days=90"),
        ("overview, all", base + "?days=all"),
        ("meals, table", base + "/meals?view=table"),
        ("meals of 28 days", base + "/meals?{window}"),
        ("meals of a participant", base + "/meals?participant={participant}"),
        ("meals with a food", base + "/meals?food={food}"),
        ("meals that need review, oldest first", base + "/meals?status=needs_review&order=oldest"),
        ("meals with a flag", base + "/meals?flag=estimated_from_one_view"),
        ("review of a participant", base + "/review?participant={participant}"),
        ("review of a food", base + "/review?food={food}"),
        ("participant, 28 days", base + "/participants/{participant}?{window}"),
        ("intakes, 28 days", base + "/intakes?{window}"),
        ("adequacy, figures of 28 days", base + "/adequacy/figures?{window}"),
        ("foods, a search", "/dashboard/foods?q=boiled+without+salt"),
    ):
        yield name, lambda values, query=query: query.format_map(values | {"window": window()})  # type: ignore[misc]


def drawn_meals(
    database: Database, study: str, shape: Shape, chance: random.Random
) -> Sequence[tuple[str, uuid.UUID]]:
    """Participants and meals of the study, from days at random."""
    days = {FIRST_DAY + timedelta(days=chance.randrange(shape.days)) for _ in range(20)}
    with database.read() as session:
        rows = session.execute(
            sa.select(Participant.code, Meal.client_id)
            .join(Meal, Meal.participant_id == Participant.id)
            .join(Study, Study.id == Meal.study_id)
            .where(Study.code == study, Meal.local_date.in_(days))
            .limit(MEALS_DRAWN)
        )
        found = [(code, client_id) for code, client_id in rows]
    if not found:
        raise SystemExit(f"no meals in {study}: fill the database by this module's benchmark")
    return found


@contextmanager
def signed_in(url: str, folder: Path) -> Iterator[httpx2.Client]:
    """A server without a worker on this database, and a browser's client that is signed in as an admin."""
    settings = Settings(
        data_dir=folder / "server",
        database_url=url,
        blob_url=None,
        erasure_url=None,
        public_url=None,
        secret_key=SecretStr(secrets.token_urlsafe(32)),
        port=0,
        min_free_bytes=0,
        log_level="WARNING",
        **NO_LIMITS,  # type: ignore[arg-type]
    )
    database = Database(url)
    name, password = f"benchmark {uuid.uuid4().hex[:8]}", secrets.token_urlsafe(16)
    try:
        create_staff(database, Passwords(), name, is_admin=True, password=password)
    finally:
        database.dispose()
    with (
        running_server(settings, "--no-worker") as address,
        httpx2.Client(base_url=address, headers=BROWSER, timeout=SLOWEST_S) as client,
    ):
        answer = client.post("/dashboard/sign-in", data={"name": name, "password": password})
        if answer.status_code != 303:  # see other
            raise SystemExit(f"signing in answered {answer.status_code}")
        yield client


def why_not(client: httpx2.Client, address: str) -> str | None:
    """Why this is not a page to measure; of a file no more than the head is read."""
    with client.stream("GET", address) as answer:
        if answer.status_code == NOTHING_NEW:
            return None
        if answer.status_code != 200:
            return f"answers {answer.status_code}"
        kind = answer.headers.get("content-type", "")
        return None if kind.startswith("text/html") else kind


def ask(client: httpx2.Client, address: str) -> tuple[float, int]:
    """Get a page: milliseconds and its size. Ends the benchmark if it does not come."""
    started = time.perf_counter()
    answer = client.get(address)
    taken_ms = (time.perf_counter() - started) * 1000
    if answer.status_code not in (200, NOTHING_NEW):
        raise SystemExit(f"{address} answered {answer.status_code}")
    return taken_ms, len(answer.content)
