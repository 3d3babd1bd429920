"""Check webhook URLs: https to a public address only, against server-side request forgery.

The server connects to a URL that a study's owner entered, which could point at services that the
server can reach but the owner cannot: a metadata service, a database, the loopback. URLs are parsed
strictly (a URL that parsers could read as different hosts is refused), the name is resolved once,
every address must be public, and the connection goes to these addresses, so that a name that
resolves differently later has no effect.
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
# below it only 443 is allowed: the other ports belong to services that receive no webhooks
LOWEST_FREE_PORT = 1024
RESOLVE_SECONDS = 5.0
LOOPBACK = "127.0.0.1"

# Addresses that are not public: IANA's special-purpose registries (RFC 6890 and its successors).
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
# The only range of global unicast addresses: mapped, NAT64, unique local, link-local, multicast ...
# are outside.
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
# not allowed by RFC 3986; URL parsers differ about some of them
_AMBIGUOUS = frozenset('\\"<>^`{|}')
_LABEL = re.compile(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?")
_NUMBER = re.compile(r"\d+|0x[0-9a-f]*")

Resolver = Callable[[str, int], list[str]]


class AddressError(InvalidInputError):
    """A webhook's URL is refused."""

    code = "webhook_address_refused"


@dataclass(frozen=True, slots=True)
class Target:
    """A parsed URL. host: a name or an address, lower case; path: with the query, as it is sent."""

    scheme: str
    host: str
    port: int
    path: str

    @property
    def host_header(self) -> str:
        """The value of the header `Host`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        standard = HTTPS_PORT if self.scheme == "https" else 80
        return host if self.port == standard else f"{host}:{self.port}"


def parse_target(url: str, *, allow_loopback: bool) -> Target:
    """Parse a URL. Raises AddressError for anything but https to a host, and for ambiguous URLs.

    allow_loopback: also accept http://127.0.0.1.
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
        raise AddressError("This is not a URL.") from None
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


def resolve_safely(
    host: str, port: int, *, allow_loopback: bool, resolve: Resolver | None = None
) -> tuple[str, ...]:
    """Return the host's addresses, all public; connect to these without resolving again.

    allow_loopback: also accept 127.0.0.1. Raises AddressError if there is no address, or one of
    them is not public.
    """
    addresses = (resolve or system_resolver)(host, port)
    if not addresses:
        raise AddressError("The name in the URL does not resolve.")
    for address in addresses:
        if not is_public(address) and not (allow_loopback and address == LOOPBACK):
            # the message leaves out the address, which would reveal the network behind the server
            raise AddressError("The URL leads to an address that is not public.")
    return tuple(addresses)


def is_public(address: str) -> bool:
    """Whether an address is public; False for text that is not an address in canonical form."""
    try:
        ip = ipaddress.ip_address(address)
    except ValueError:
        return False
    if isinstance(ip, ipaddress.IPv4Address):
        return not any(ip in network for network in NOT_PUBLIC_V4)
    if ip.scope_id is not None or ip not in GLOBAL_UNICAST_V6 or ip.packed[8:12] in ISATAP_MARKS:
        return False
    return not any(ip in network for network in NOT_PUBLIC_V6)


def system_resolver(host: str, port: int) -> list[str]:
    """Return the host's addresses in the system's order; none if it does not resolve within RESOLVE_SECONDS."""
    addresses: list[str] = []

    def resolve() -> None:
        try:
            answers = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError):
            return
        addresses.extend(dict.fromkeys(str(answer[4][0]) for answer in answers))

    # getaddrinfo has no time-out
    thread = threading.Thread(target=resolve, name="resolve", daemon=True)
    thread.start()
    thread.join(RESOLVE_SECONDS)
    return list(addresses)


def _read_host(host: str) -> str:
    """Return a name of at least two labels, or an address in canonical form.

    Raises AddressError.
    """
    if ":" in host:
        try:
            ip = ipaddress.IPv6Address(host)
        except ValueError:
            raise AddressError("The URL's host is not an IPv6 address.") from None
        if ip.scope_id is not None:
            raise AddressError("The URL's address may not have a zone.")
        return str(ip)
    labels = host.split(".")
    if _NUMBER.fullmatch(labels[-1]):  # some parsers read 127.1, 0x7f000001 or 017700000001 as IPv4
        try:
            return str(ipaddress.IPv4Address(host))
        except ValueError:
            raise AddressError("Write an IPv4 address as four decimal numbers.") from None
    if len(labels) < 2 or not all(_LABEL.fullmatch(label) for label in labels):
        raise AddressError("The URL needs a full host name, such as hooks.example.org.")
    return host
