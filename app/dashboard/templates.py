"""Jinja2 as the pages use it: everything escaped, a name that is missing is an error, numbers shown with their unit.

A number is shown rounded and carried whole: `<data value="...">` holds what the API and the exports have, so that what
a page says can be compared with them.
"""

import hashlib
import json
from collections.abc import Mapping
from datetime import UTC, date, datetime
from functools import cache
from pathlib import Path
from urllib.parse import urlencode
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from jinja2 import Environment, FileSystemLoader, StrictUndefined, pass_context
from jinja2.runtime import Context
from markupsafe import Markup, escape

from app import __version__
from app.dashboard.addresses import study_address
from app.dashboard.menus import server_menu, study_menu
from app.people.access.page_rules import PREFIX

FOLDER = Path(__file__).parent
STATIC = FOLDER / "static"
NOT_KNOWN = Markup('<span class="unknown" title="not known">–</span>')


def render(template: str, **context: object) -> str:
    """A template of templates/ as HTML."""
    return environment().get_template(template).render(**context)


@cache
def environment() -> Environment:
    """Made once a process, with its first page."""
    made = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals |= {"static": static, "prefix": PREFIX, "version": __version__, "study_url": study_url}
    made.globals |= {"study_menu": study_menu, "server_menu": server_menu}
    made.filters |= {
        "amount": amount,
        "interval": interval,
        "percent": percent,
        "instant": instant,
        "day": day,
        "seconds": seconds,
        "words": words,
        "listed": listed,
        "asked": asked,
        "json_data": json_data,
        "bytes": byte_count,
    }
    return made


@cache
def static(path: str) -> str:
    """The address of a file of static/; it changes with the file, so that browsers may keep it for good."""
    digest = hashlib.sha256((STATIC / path).read_bytes()).hexdigest()[:12]
    return f"{PREFIX}/static/{path}?v={digest}"


@pass_context
def study_url(context: Context, *parts: object) -> str:
    """The address of a page of the study that is looked at; each part is quoted."""
    return study_address(context["page"].study.code, *parts)


def amount(value: float | None, unit: str = "", digits: int | None = None) -> Markup:
    """A number with its unit; a float is rounded to what matters (three figures below 100, else whole); – if None."""
    if value is None:
        return NOT_KNOWN
    shown = f"{value:,.{_decimals(value) if digits is None else digits}f}".replace(",", " ").replace("-", "−")
    return _number(value, f"{shown}{_unit(unit)}" if unit else shown)


def interval(low_high: tuple[float, float] | None, unit: str = "") -> Markup:
    """A 90 % interval; nothing if None."""
    if low_high is None or low_high[0] is None or low_high[1] is None:
        return Markup("")
    low, high = low_high
    return Markup('<span class="interval" title="90 % interval">{} to {}</span>').format(
        amount(low, digits=_decimals(high)), amount(high, unit)
    )


def percent(share: float | None, digits: int = 0) -> Markup:
    """A share of 1 as a percentage; – if None."""
    if share is None:
        return NOT_KNOWN
    return _number(share, f"{100 * share:.{digits}f} %")


def instant(value: datetime | None, time_zone: str | None = None) -> Markup:
    """An instant, in this IANA zone (default UTC), to the minute; – if None."""
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
    """A local day; – if None."""
    if value is None:
        return NOT_KNOWN
    told = date.isoformat(value)
    return Markup(f'<time datetime="{told}">{told}</time>')  # noqa: S704  # digits and hyphens


def seconds(value: float | None) -> Markup:
    """A duration as a person would say it: 850 ms, 12 s, 3 min, 5 h, 2 d."""
    if value is None:
        return NOT_KNOWN
    size = abs(value)
    for unit_seconds, unit in ((86_400, "d"), (3_600, "h"), (60, "min")):
        if size >= 2 * unit_seconds:
            shown = f"{value / unit_seconds:.0f} {unit}"
            break
    else:
        shown = f"{value:.0f} s" if size >= 10 else f"{value:.1f} s" if size >= 1 else f"{1000 * value:.0f} ms"
    return _number(value, shown)


def byte_count(value: int | None) -> Markup:
    """A size in bytes, kB or MB; – if None."""
    if value is None:
        return NOT_KNOWN
    for size, unit in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if value >= size:
            return _number(value, f"{value / size:.1f} {unit}")
    return _number(value, f"{value} B")


def words(code: str | None) -> Markup:
    """A code of ours (needs_review) as words, the code itself kept beside it for who looks it up."""
    if code is None:
        return NOT_KNOWN
    return Markup('<span title="{}">{}</span>').format(code, code.replace("_", " "))


def listed(value: object) -> str:
    """A value of JSON as a line of text: a list with commas, an object by its names, yes and no; – if None."""
    match value:
        case None:
            return "–"
        case bool():
            return "yes" if value else "no"
        case list() | tuple():
            return ", ".join(listed(one) for one in value) or "none"
        case dict():
            return ", ".join(f"{name} {listed(one)}" for name, one in value.items()) or "none"
        case _:
            return str(value)


def asked(parameters: Mapping[str, object]) -> str:
    """Parameters as an address's query; those that say nothing are left out."""
    return urlencode({name: value for name, value in parameters.items() if value not in (None, "")})


def json_data(value: object) -> Markup:
    """JSON for a <script type="application/json">: no text of it can end the element."""
    text = json.dumps(value, default=str, allow_nan=False)
    for character in "&<>\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)  # noqa: S704  # every character that HTML reads is written as a number


def _decimals(value: float) -> int:
    size = abs(value)
    return 0 if isinstance(value, int) or size >= 100 or size == 0 else 1 if size >= 10 else 2


def _number(value: float, shown: str) -> Markup:
    """A number as it is shown, with itself beside it. A page of days has thousands: nothing in here needs escaping."""
    exact = repr(value) if isinstance(value, int) else float.__repr__(value)
    return Markup(f'<data class="num" value="{exact}">{shown}</data>')  # noqa: S704  # digits, and units of ours


@cache
def _unit(unit: str) -> str:
    return f' <span class="unit">{escape(unit)}</span>'
