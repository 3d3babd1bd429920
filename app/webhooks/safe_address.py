"""Where a webhook may go: https to a public address, and to no other (server-side request forgery).

A URL that a study's owner typed in makes the server call out, so it could be turned against what the server can reach
and the owner cannot: a metadata service, a database, the loopback. A URL is read strictly (what two readers would take
for two hosts is refused), its name is resolved once, every answer must be public, and who connects uses these very
addresses: a name that resolves to something else a moment later gains nothing.
"""

import ipaddress
import re
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import urlsplit

from app.core.errors import InvalidInputError

MAX_URL_LENGTH = 500
HTTPS_PORT = 443
LOWEST_FREE_PORT = 1024  # of those below, only 443: the rest belongs to services that are no webhook's receiver
RESOLVE_SECONDS = 5.0
LOOPBACK = "127.0.0.1"

# Addresses that lead nowhere public: IANA's special-purpose registries (RFC 6890 and its successors).
NOT_PUBLIC_V4 = tuple(
    ipaddress.IPv4Network(network)
    for network in (
        "0.0.0.0/8",  # this network
        "10.0.0.0/8",  # private
        "100.64.0.0/10",  # carriers' NAT
        "127.0.0.0/8",  # loopback
        "169.254.0.0/16",  # link-local, clouds' metadata
        "172.16.0.0/12",  # private
        "192.0.0.0/24",  # protocol assignments
        "192.0.2.0/24",  # documentation
        "192.88.99.0/24",  # 6to4 relays
        "192.168.0.0/16",  # private
        "198.18.0.0/15",  # benchmarks
        "198.51.100.0/24",  # documentation
        "203.0.113.0/24",  # documentation
        "224.0.0.0/4",  # multicast
        "240.0.0.0/4",  # reserved, broadcast
    )
)
# Only this is handed out as global unicast: mapped, NAT64, unique local, link-local, multicast ... lie outside of it.
GLOBAL_UNICAST_V6 = ipaddress.IPv6Network("2000::/3")
NOT_PUBLIC_V6 = tuple(
    ipaddress.IPv6Network(network)
    for network in (
        "2001::/23",  # protocol assignments: Teredo, ORCHID, benchmarks
        "2001:db8::/32",  # documentation
        "2002::/16",  # 6to4: an IPv4 address in disguise
        "3fff::/20",  # documentation
    )
)
ISATAP_MARKS = (b"\x00\x00\x5e\xfe", b"\x02\x00\x5e\xfe")  # RFC 5214: an IPv4 address follows

_VISIBLE_ASCII = re.compile(r"[!-~]+")
_AMBIGUOUS = frozenset('\\"<>^`{|}')  # RFC 3986 allows none of them; readers of URLs differ about some
_LABEL = re.compile(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?")
_NUMBER = re.compile(r"\d+|0x[0-9a-f]*")

Resolver = Callable[[str, int], list[str]]


class AddressError(InvalidInputError):
    """A webhook cannot go there."""

    code = "webhook_address_refused"


@dataclass(frozen=True, slots=True)
class Target:
    """A URL taken apart. host: a name or an address, lower case; path: with the query, as it goes over the wire."""

    scheme: str
    host: str
    port: int
    path: str

    @property
    def host_header(self) -> str:
        """The header `Host`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        standard = HTTPS_PORT if self.scheme == "https" else 80
        return host if self.port == standard else f"{host}:{self.port}"


def parse_target(url: str, *, allow_loopback: bool) -> Target:
    """The URL's parts. Raises AddressError for anything but https to a host, and for what can be read in two ways.

    allow_loopback: http://127.0.0.1 is taken too.
    """
    if len(url) > MAX_URL_LENGTH:
        raise AddressError(f"The URL is longer than {MAX_URL_LENGTH} characters.")
    if not _VISIBLE_ASCII.fullmatch(url) or _AMBIGUOUS & set(url):
        raise AddressError(
            "The URL may hold visible ASCII characters only; write an international name as xn--..., the rest as %XX."
        )
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise AddressError("This is no URL.") from None
    if "#" in url:
        raise AddressError("The URL may not have a fragment (#).")
    if "@" in parts.netloc:
        raise AddressError("The URL may not hold a user name or a password: deliveries are signed.")
    host = _read_host(parts.hostname or "")
    is_loopback = allow_loopback and host == LOOPBACK
    if parts.scheme != "https" and not (is_loopback and parts.scheme == "http"):
        raise AddressError("The URL must begin with https://.")
    if port is None:
        if parts.netloc.endswith(":"):
            raise AddressError("The URL has a colon without a port.")
        port = HTTPS_PORT if parts.scheme == "https" else 80
    if port != HTTPS_PORT and port < LOWEST_FREE_PORT and not is_loopback:
        raise AddressError(f"The port must be {HTTPS_PORT}, or {LOWEST_FREE_PORT} and above.")
    path = parts.path or "/"
    return Target(parts.scheme, host, port, f"{path}?{parts.query}" if parts.query else path)


def resolve_safely(target: Target, *, allow_loopback: bool, resolve: Resolver | None = None) -> tuple[str, ...]:
    """The addresses of the target, all of them public; connect to these and resolve no more.

    allow_loopback: 127.0.0.1 passes too. Raises AddressError if there is none, or if one of them is not public.
    """
    addresses = (resolve or system_resolver)(target.host, target.port)
    if not addresses:
        raise AddressError("The name in the URL does not resolve.")
    for address in addresses:
        if not is_public(address) and not (allow_loopback and address == LOOPBACK):
            # the address itself is not told: it would draw a map of the network behind the server
            raise AddressError("The URL leads to an address that is not public.")
    return tuple(addresses)


def is_public(address: str) -> bool:
    """Whether an address is of the public internet. False for what is no address in its usual form."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return False
    if isinstance(found, ipaddress.IPv4Address):
        return not any(found in network for network in NOT_PUBLIC_V4)
    if found.scope_id is not None or found not in GLOBAL_UNICAST_V6 or found.packed[8:12] in ISATAP_MARKS:
        return False
    return not any(found in network for network in NOT_PUBLIC_V6)


def system_resolver(host: str, port: int) -> list[str]:
    """The host's addresses in the system's order; none where it does not resolve, or not within RESOLVE_SECONDS."""
    found: list[str] = []

    def ask() -> None:
        try:
            answers = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError):
            return
        found.extend(dict.fromkeys(str(answer[4][0]) for answer in answers))

    asking = threading.Thread(target=ask, name="resolve", daemon=True)  # getaddrinfo takes no time-out
    asking.start()
    asking.join(RESOLVE_SECONDS)
    return list(found)


def _read_host(host: str) -> str:
    """A name of two labels or more, or an address in its one usual form. Raises AddressError."""
    if ":" in host:
        try:
            found = ipaddress.IPv6Address(host)
        except ValueError:
            raise AddressError("The URL's host is no IPv6 address.") from None
        if found.scope_id is not None:
            raise AddressError("The URL's address may not have a zone.")
        return str(found)
    labels = host.split(".")
    if _NUMBER.fullmatch(
        labels[-1]
    ):  # "ends in a number": some readers take 127.1, 0x7f000001 or 017700000001 for IPv4
        try:
            return str(ipaddress.IPv4Address(host))
        except ValueError:
            raise AddressError("Write an IPv4 address as four decimal numbers.") from None
    if len(labels) < 2 or not all(_LABEL.fullmatch(label) for label in labels):
        raise AddressError("The URL needs a full host name, such as hooks.example.org.")
    return host
