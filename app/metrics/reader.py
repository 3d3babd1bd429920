"""Who may read the metrics: whoever has the token; without one, callers on the same machine that came by no proxy.

Figures name nobody, but how many meals a study machine takes and why they fail is nobody's business.
"""

import ipaddress
import secrets
from collections.abc import Mapping
from typing import Literal

# what proxies add: with one of them a caller on this machine is somebody else's messenger
FORWARDING_HEADERS = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip", "via")
LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})

Word = Literal["may read", "wrong token", "hidden"]


def may_read(token: str | None, address: str | None, headers: Mapping[str, str]) -> Word:
    """token: the one that is set. address: the caller's. headers: by lower-case name.

    "hidden": no token is set and the caller is elsewhere; they need not know that there is something to read.
    """
    if token is not None:
        scheme, _, given = headers.get("authorization", "").partition(" ")
        is_right = secrets.compare_digest(given.strip().encode(), token.encode())
        return "may read" if scheme.lower() == "bearer" and is_right else "wrong token"
    return "may read" if _is_here(address) and _came_straight(headers) else "hidden"


def _is_here(address: str | None) -> bool:
    try:
        found = ipaddress.ip_address((address or "").partition("%")[0])
    except ValueError:
        return False
    mapped = found.ipv4_mapped if isinstance(found, ipaddress.IPv6Address) else None
    return (mapped or found).is_loopback


def _came_straight(headers: Mapping[str, str]) -> bool:
    """By no proxy that says so, and asked for by a local name: a page in a browser here could ask by another's."""
    host = headers.get("host", "")
    name = host if host.endswith("]") else host.rpartition(":")[0] or host
    return name.lower() in LOCAL_NAMES and not any(header in headers for header in FORWARDING_HEADERS)
