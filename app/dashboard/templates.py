"""The Jinja2 environment of the pages, its filters, and the static files.

Autoescaping; undefined names raise. Scripts, styles and pictures are public: they hold no data.

A number is shown rounded; `<data value="...">` holds it in full, so that it can be compared with
API and exports.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime
from functools import cache
from pathlib import Path
from urllib.parse import urlencode, urlsplit
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from jinja2 import Environment, FileSystemLoader, StrictUndefined, pass_context
from jinja2.runtime import Context
from markupsafe import Markup, escape
from starlette.responses import Response
from starlette.types import Scope

from app import __version__
from app.http.ranges import PublicFiles
from app.people.access.caller import reaches
from app.people.access.page_rules import PREFIX, study_address
from app.people.models import Role
from app.records.review.queries import MOST_MEALS

FOLDER = Path(__file__).parent
STATIC = FOLDER / "static"
MOST_DECIMALS = 6
NOT_KNOWN = Markup('<span class="unknown" title="not known">–</span>')
# of an address that changes with its file (templates.static)
FOR_GOOD = "public, max-age=31536000, immutable"
ASK_FIRST = "no-cache"


@dataclass(frozen=True, slots=True)
class Entry:
    """A page: path below the study (or the dashboard), label, lowest role that may see it."""

    path: tuple[str, ...]
    label: str
    needs: Role = "viewer"


FOODS = Entry(("foods",), "Foods")  # of the whole server
STUDY: Mapping[str, tuple[Entry, ...]] = {
    "Data": (
        Entry((), "Overview"),
        Entry(("meals",), "Meals"),
        Entry(("review",), "Review", "reviewer"),
        Entry(("blind",), "Blind review", "reviewer"),
        FOODS,
    ),
    "People": (
        Entry(("participants",), "Participants"),
        Entry(("devices",), "Devices"),
        Entry(("enrol",), "Cards", "owner"),
        Entry(("flow",), "Flow"),
    ),
    "Results": (
        Entry(("intakes",), "Intakes"),
        Entry(("adequacy",), "Adequacy"),
        Entry(("agreement",), "Agreement"),
        Entry(("reference",), "Against a reference"),
        Entry(("exports",), "Exports"),
        Entry(("releases",), "Releases"),
    ),
    "Setup": (
        Entry(("settings",), "Settings"),
        Entry(("members",), "Members", "owner"),
        Entry(("densities",), "Densities"),
        Entry(("vessels",), "Vessels"),
        Entry(("remeasurements",), "Remeasurements"),
        Entry(("webhooks",), "Webhooks", "owner"),
        Entry(("audit",), "Audit log", "owner"),
    ),
}
SERVER: tuple[Entry, ...] = (FOODS, Entry(("marker",), "Marker"), Entry(("account",), "Account"))
ADMIN: tuple[Entry, ...] = (Entry(("staff",), "Staff"), Entry(("audit",), "Audit log"))


def study_menu(role: Role | None) -> dict[str, list[Entry]]:
    """Return group -> the study's pages that this role may see."""
    return {
        group: [entry for entry in entries if reaches(role, entry.needs)]
        for group, entries in STUDY.items()
    }


def server_menu(*, is_admin: bool) -> list[Entry]:
    """Return the pages that belong to no study."""
    return [*SERVER, *(ADMIN if is_admin else ())]


def render(template: str, **context: object) -> str:
    """Render a template of templates/."""
    return environment().get_template(template).render(**context)


@cache
def environment() -> Environment:
    """Return the process's Jinja2 environment."""
    jinja = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    jinja.globals |= {
        "static": static,
        "prefix": PREFIX,
        "version": __version__,
        "study_url": study_url,
    }
    jinja.globals |= {"study_menu": study_menu, "foods_entry": FOODS, "server_menu": server_menu}
    jinja.globals["most_meals"] = MOST_MEALS
    jinja.filters |= {
        "amount": amount,
        "interval": interval,
        "percent": percent,
        "instant": instant,
        "day": day,
        "seconds": seconds,
        "words": words,
        "listed": listed,
        "query": query_string,
        "json_data": json_data,
        "bytes": byte_count,
    }
    return jinja


@cache
def static(path: str) -> str:
    """Return the address of a file of static/; it changes with the file, so that browsers may keep it for good."""
    digest = hashlib.sha256((STATIC / path).read_bytes()).hexdigest()[:12]
    return f"{PREFIX}/static/{path}?v={digest}"


@pass_context
def study_url(context: Context, *parts: object) -> str:
    """Return the address of a page of the current study; each part is quoted."""
    return study_address(context["page"].study.code, *parts)


def amount(value: float | None, unit: str = "", digits: int | None = None) -> Markup:
    """Format a number with its unit.

    Floats below 100 get three significant figures, below 1 two, others none after the point; from a
    billion on they are written as powers of ten, which leave the next column free.
    """
    if value is None:
        return NOT_KNOWN
    if isinstance(value, float) and abs(value) >= 1e9:
        written = f"{value:.2e}"
    else:
        written = f"{value:,.{_decimals(value) if digits is None else digits}f}"
    shown = written.replace(",", " ").replace("-", "−")
    return _number(value, f"{shown}{_unit(unit)}" if unit else shown)


def interval(low_high: tuple[float, float] | None, unit: str = "") -> Markup:
    """Format a 90 % interval; empty if a bound is None."""
    if low_high is None or low_high[0] is None or low_high[1] is None:
        return Markup("")
    low, high = low_high
    return Markup('<span class="interval" title="90 % interval">{} to {}</span>').format(
        amount(low), amount(high, unit)
    )


def percent(share: float | None, digits: int = 0) -> Markup:
    """Format a share of 1 as a percentage; – if None."""
    if share is None:
        return NOT_KNOWN
    return _number(share, f"{100 * share:.{digits}f} %")


def instant(value: datetime | None, time_zone: str | None = None) -> Markup:
    """Format an instant to the minute in this IANA zone (default UTC); – if None."""
    if value is None:
        return NOT_KNOWN
    aware = value if value.tzinfo is not None else value.replace(tzinfo=UTC)
    try:
        shown = aware.astimezone(ZoneInfo(time_zone) if time_zone else UTC)
    except (ZoneInfoNotFoundError, ValueError):
        shown, time_zone = aware.astimezone(UTC), None
    return Markup('<time datetime="{}" title="{}">{}</time>').format(
        aware.astimezone(UTC).isoformat(), time_zone or "UTC", f"{shown:%Y-%m-%d %H:%M}"
    )


def day(value: date | None) -> Markup:
    """Format a local day; – if None."""
    if value is None:
        return NOT_KNOWN
    text = date.isoformat(value)
    return Markup(f'<time datetime="{text}">{text}</time>')  # noqa: S704  # digits and hyphens


def seconds(value: float | None) -> Markup:
    """Format a duration in its natural unit: 850 ms, 12 s, 3 min, 5 h, 2 d; – if None."""
    if value is None:
        return NOT_KNOWN
    size = abs(value)
    for unit_seconds, unit in ((86_400, "d"), (3_600, "h"), (60, "min")):
        if size >= 2 * unit_seconds:
            shown = f"{value / unit_seconds:.0f} {unit}"
            break
    else:
        shown = (
            f"{value:.0f} s"
            if size >= 10
            else f"{value:.1f} s"
            if size >= 1
            else f"{1000 * value:.0f} ms"
        )
    return _number(value, shown)


def byte_count(value: int | None) -> Markup:
    """Format a size in B, kB, MB or GB; – if None."""
    if value is None:
        return NOT_KNOWN
    for size, unit in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if value >= size:
            return _number(value, f"{value / size:.1f} {unit}")
    return _number(value, f"{value} B")


def words(code: str | None) -> Markup:
    """Format a code such as needs_review as words, with the code itself as the title; – if None."""
    if code is None:
        return NOT_KNOWN
    return Markup('<span title="{}">{}</span>').format(code, code.replace("_", " "))


def listed(value: object) -> str:
    """Format a JSON value as a line of text: lists with commas, objects as name and value, yes and no; – if None."""
    match value:
        case None:
            return "–"
        case bool():
            return "yes" if value else "no"
        case list() | tuple():
            return ", ".join(listed(part) for part in value) or "none"
        case dict():
            return ", ".join(f"{name} {listed(part)}" for name, part in value.items()) or "none"
        case _:
            return str(value)


def query_string(parameters: Mapping[str, object]) -> str:
    """Encode parameters as an address's query, without empty ones."""
    return urlencode({name: value for name, value in parameters.items() if value not in (None, "")})


def json_data(value: object) -> Markup:
    """Encode a value as JSON for <script type="application/json">; no text in it can end the element."""
    text = json.dumps(value, default=str, allow_nan=False)
    for character in "&<>\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)  # noqa: S704  # every character that HTML reads is written as a number


def _decimals(value: float) -> int:
    size = abs(value)
    if isinstance(value, int) or size >= 100 or size == 0:
        return 0
    if size >= 0.1:
        return 1 if size >= 10 else 2
    return min(1 - math.floor(math.log10(size)), MOST_DECIMALS)


def _number(value: float, shown: str) -> Markup:
    """Wrap a formatted number with its exact value.

    Not escaped, for speed: a page of days has thousands.
    """
    exact = repr(value) if isinstance(value, int) else float.__repr__(value)
    return Markup(f'<data class="num" value="{exact}">{shown}</data>')  # noqa: S704  # digits, and units of ours


@cache
def _unit(unit: str) -> str:
    return f' <span class="unit">{escape(unit)}</span>'


class DashboardFiles(PublicFiles):
    """Serves static/; a browser may keep a file for good if its address names this version of it."""

    def __init__(self) -> None:
        super().__init__(directory=STATIC)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file with its Cache-Control header.

        During an upgrade a page of one version may request files from a server of the other
        version. Such a file must not be cached for good under the page's address.
        """
        answer: Response = await super().get_response(path, scope)
        is_of_this_version = scope["query_string"].decode("latin-1") == urlsplit(static(path)).query
        answer.headers["Cache-Control"] = FOR_GOOD if is_of_this_version else ASK_FIRST
        return answer
