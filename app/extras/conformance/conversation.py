"""A recorded conversation of one phone with a server: what the checks judge."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Fault = Literal[
    "lost_answer", "lost_request", "unavailable", "rate_limited", "not_durable", "stale"
]

GRACE_SECONDS = 60.0  # an app that goes on talking for so long without what is expected of it has failed to do it
_MEAL = re.compile(r"^/v1/meals/([^/]+)")
_IMAGE = re.compile(r"^/v1/meals/[^/]+/images/([^/]+)")


@dataclass(frozen=True, slots=True)
class SentPhotograph:
    """A photograph that arrived whole. media_type: by its bytes; None: no photograph that the server reads."""

    slot: str
    sha256: str
    media_type: str | None
    has_exif: bool


@dataclass(frozen=True, slots=True)
class Exchange:
    """One request and its answer.

    at, ended_at: s, on one clock. status: None if the connection ended without a whole answer. answer: the JSON object
    that was answered, or an empty one. upload_offset: bytes before those of a piece (tus). fault: what the observer did
    to it.
    """

    at: float
    ended_at: float
    method: str
    path: str
    status: int | None
    is_authorised: bool = True
    has_secret_in_url: bool = False
    if_match: str | None = None
    metadata: Mapping[str, Any] | None = None
    photographs: tuple[SentPhotograph, ...] = ()
    upload_offset: int | None = None
    retry_after: float | None = None
    answer: Mapping[str, Any] = field(default_factory=dict)
    fault: Fault | None = None

    @property
    def call(self) -> str:
        """The method and the path."""
        return f"{self.method} {self.path}"

    @property
    def meal(self) -> str | None:
        """The id of the meal that it is about."""
        match = _MEAL.match(self.path)
        if match is not None:
            return match[1].lower()
        name = (
            (self.metadata or {}).get("id")
            if self.path == "/v1/meals" and self.method == "POST"
            else None
        )
        return str(name).lower() if name is not None else None

    @property
    def content(self) -> tuple[str, str] | None:
        """The meal and the part of it that is sent: `metadata`, or a photograph's slot."""
        image, meal = _IMAGE.match(self.path), self.meal
        # of an upload in pieces
        is_creation = self.method == "POST" and self.path.endswith("/upload")
        if meal is None or is_creation or self.method not in {"PUT", "POST", "PATCH"}:
            return None
        if image is not None:
            return meal, image[1]
        return (meal, "metadata") if self.path in {"/v1/meals", f"/v1/meals/{meal}"} else None

    @property
    def code(self) -> str | None:
        """The code of the problem document that was answered."""
        code = self.answer.get("code")
        return code if isinstance(code, str) and not self.is_ok else None

    @property
    def is_ok(self) -> bool:
        """True if the request was carried out and the phone received the answer."""
        return self.status is not None and self.status < 400

    @property
    def durable(self) -> frozenset[str]:
        """The slots that the answer calls durable."""
        images = self.answer.get("images") if self.is_ok else None
        return (
            frozenset(slot for slot, image in images.items() if image.get("durable"))
            if images
            else frozenset()
        )


@dataclass(frozen=True, slots=True)
class Conversation:
    """The exchanges of one phone, in the order of its requests. now: s, on their clock."""

    device_name: str
    exchanges: tuple[Exchange, ...]
    now: float

    def after(self, exchange: Exchange) -> tuple[Exchange, ...]:
        """The later exchanges."""
        return self.exchanges[self.exchanges.index(exchange) + 1 :]

    def with_fault(self, *faults: Fault) -> Iterator[Exchange]:
        """The exchanges that were disturbed so."""
        return (exchange for exchange in self.exchanges if exchange.fault in faults)

    def again(self, exchange: Exchange) -> Exchange | None:
        """The next attempt at an exchange: the same part of the same meal, or the same call."""
        key = exchange.content
        for later in self.after(exchange):
            if (
                later.content == key
                if key is not None
                else (later.method, later.path) == (exchange.method, exchange.path)
            ):
                return later
        return None

    def is_overdue(self, exchange: Exchange, seconds: float = GRACE_SECONDS) -> bool:
        """Return True if the phone went on with other requests for so long after an exchange."""
        return any(later.at - exchange.ended_at > seconds for later in self.after(exchange))

    @property
    def complete_meals(self) -> frozenset[str]:
        """The meals of which the server has said that nothing is missing."""
        return frozenset(
            exchange.meal
            for exchange in self.exchanges
            if exchange.meal is not None and exchange.is_ok and exchange.answer.get("missing") == []
        )
