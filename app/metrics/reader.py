"""Access to the metrics: callers with the token; if none is set, callers on the same machine that use no proxy.

Metrics name nobody, but numbers of meals and causes of failures are not public.
"""

import ipaddress
import secrets
from collections.abc import Mapping
from typing import Literal

# headers added by proxies: a local caller that sends one forwards another caller's request
FORWARDING_HEADERS = (
    "forwarded",
    "x-forwarded-for",
    "x-forwarded-host",
    "x-forwarded-proto",
    "x-real-ip",
    "via",
)
LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})

Access = Literal["may read", "wrong token", "hidden"]


def may_read(token: str | None, address: str | None, headers: Mapping[str, str]) -> Access:
    """Return a caller's access. token: the configured one. address: the caller's. headers: by lower-case name.

    "hidden": no token is set and the caller is remote; it should not learn that metrics exist.
    """
    if token is not None:
        scheme, _, sent_token = headers.get("authorization", "").partition(" ")
        is_right = secrets.compare_digest(sent_token.strip().encode(), token.encode())
        return "may read" if scheme.lower() == "bearer" and is_right else "wrong token"
    return "may read" if _is_local(address) and _is_direct(headers) else "hidden"


def _is_local(address: str | None) -> bool:
    try:
        ip = ipaddress.ip_address((address or "").partition("%")[0])
    except ValueError:
        return False
    mapped = ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None
    return (mapped or ip).is_loopback


def _is_direct(headers: Mapping[str, str]) -> bool:
    """Return whether no proxy is declared and the host name is local: pages in a local browser may use other names."""
    host = headers.get("host", "")
    name = host if host.endswith("]") else host.rpartition(":")[0] or host
    return name.lower() in LOCAL_NAMES and not any(
        header in headers for header in FORWARDING_HEADERS
    )
