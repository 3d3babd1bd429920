"""Where webhooks may go. Each refused address and URL here is a way in which servers were made to call themselves."""

import ipaddress
import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.webhooks import safe_address
from app.webhooks.safe_address import AddressError, is_public, parse_target, resolve_safely, system_resolver
from tests.support.waiting import PATIENCE_SECONDS

NOT_PUBLIC = """
0.0.0.0 10.0.0.1 100.64.0.1 100.127.255.254 127.0.0.1 169.254.169.254 172.16.0.1 172.31.255.255 192.0.0.8 192.0.0.192
192.0.2.1 192.88.99.1 192.168.1.1 198.18.0.1 198.19.255.255 198.51.100.1 203.0.113.1 224.0.0.1 240.0.0.1 255.255.255.255
:: ::1 ::8.8.8.8 ::ffff:8.8.8.8 ::ffff:0:127.0.0.1 64:ff9b::808:808 64:ff9b:1::a00:1 100::1 2001::1 2001:2::1 2001:20::1
2001:db8::1 2002:7f00:1:: 2606:4700::5efe:7f00:1 3fff::1 5f00::1 fc00::1 fe80::1 2606:4700::1%eth0 fec0::1 ff02::1
4000::1 no-address
"""  # also public IPv4 addresses in the disguises of IPv6: translated, mapped, NAT64, Teredo, 6to4, ISATAP
PUBLIC = ["1.1.1.1", "8.8.8.8", "9.255.255.255", "100.63.255.255", "100.128.0.1", "128.0.0.1", "172.15.0.1"]
PUBLIC += ["172.32.0.1", "192.0.1.1", "198.17.0.1", "198.20.0.1", "223.255.255.255", "2606:4700::1111"]
PUBLIC += ["2001:4860:4860::8888", "2a00:1450:4001::1", "2003::1"]

REFUSED_URLS = [
    # schemes
    "http://hooks.example.org/", "file:///etc/passwd", "//hooks.example.org/", "", "https:///path",
    "http://127.0.0.1:8000/",  # without the setting
    # who is it for: parts that readers of URLs take differently
    "https://user@hooks.example.org/", "https://@hooks.example.org/", "https://hooks.example.org\\@127.0.0.1/",
    "https:\\\\hooks.example.org/", "https://hooks.example.org/#fragment", "https://hooks.example.org/#",
    " https://hooks.example.org/", "https://hooks.example.org/a b", "https://hooks.example.org/\r\nHost: 127.0.0.1",
    "https://hooks\t.example.org/", "https://hooks.example.org/\x7f", "https://hooks.example.org/" + "a" * 500,
    # names, also of one label: the host itself, or whatever the search list makes of them
    "https://hooks.example.org:/", "https://hooks..example.org/", "https://example.org./", "https://-a.example.org/",
    "https://a-.example.org/", "https://a_b.example.org/", f"https://{'a' * 64}.example.org/", "https://localhost/",
    # numbers that some resolvers take for an address, and letters that normalise to others
    "https://2130706433/", "https://0x7f000001/", "https://127.1/", "https://1.2.3.4.5/", "https://hooks.example.0x1/",
    "https://1.2.3.0x/", "https://１２７.0.0.1/", "https://127。0。0。1/", "https://bücher.example/",
    # addresses and ports
    "https://[::1", "https://::1/", "https://[fe80::1%eth0]/", "https://[hooks.example.org]/", "https://[]/",
    "https://hooks.example.org:442/", "https://hooks.example.org:444/", "https://hooks.example.org:1023/",
    "https://hooks.example.org:65536/", "https://hooks.example.org:0x1bb/", "https://hooks.example.org:٤٤٣/",
]  # fmt: skip

GOOD_URLS = {
    "https://Hooks.Example.ORG/Path?a=B&c=%20": ("hooks.example.org", 443, "/Path?a=B&c=%20", "hooks.example.org"),
    "HTTPS://hooks.example.org:443/": ("hooks.example.org", 443, "/", "hooks.example.org"),
    "https://hooks.example.org:1024/a": ("hooks.example.org", 1024, "/a", "hooks.example.org:1024"),
    "https://hooks.example.org:65535?x": ("hooks.example.org", 65535, "/?x", "hooks.example.org:65535"),
    "https://8.8.8.8/": ("8.8.8.8", 443, "/", "8.8.8.8"),
    "https://xn--bcher-kva.example/": ("xn--bcher-kva.example", 443, "/", "xn--bcher-kva.example"),
    "https://[2606:4700:0:0::1111]:8443/": ("2606:4700::1111", 8443, "/", "[2606:4700::1111]:8443"),
    "https://1.example.org/": ("1.example.org", 443, "/", "1.example.org"),
}


def resolving_to(*addresses):
    return lambda host, port: list(addresses)


@pytest.mark.parametrize("address", [*NOT_PUBLIC.split(), ""])
def test_non_public_address_is_detected(address):
    assert not is_public(address)


@pytest.mark.parametrize("address", PUBLIC)
def test_public_address_passes(address):
    assert is_public(address)


@given(st.ip_addresses())
def test_nothing_that_python_calls_private_passes(address):
    """An independent table: Python's own, of the same registries."""
    if is_public(str(address)):
        assert address.is_global or address in ipaddress.ip_network("2620:4f:8000::/48")
        refused = (address.is_private, address.is_multicast, address.is_reserved, address.is_loopback)
        assert not any(refused)


@pytest.mark.parametrize("url", REFUSED_URLS)
def test_url_is_refused(url):
    with pytest.raises(AddressError) as refused:
        parse_target(url, allow_loopback=False)
    assert (refused.value.code, refused.value.status) == ("webhook_address_refused", 422)


@pytest.mark.parametrize("url", GOOD_URLS)
def test_valid_url_is_parsed(url):
    target = parse_target(url, allow_loopback=False)
    assert (target.host, target.port, target.path, target.host_header) == GOOD_URLS[url]
    assert target.scheme == "https"


@given(st.text("aZ09.-_:/\\@#?%[]& \t\r\n\x00\u00e9\uff11\u3002\uff0f\u24db\u200b", max_size=60))
def test_any_text_is_parsed_or_refused(text):
    for url in (text, f"https://{text}/", f"https://hooks.example.org{text}"):
        try:
            target = parse_target(url, allow_loopback=False)
        except AddressError:
            continue
        assert target.scheme == "https"
        assert (target.host_header + target.path).isascii()
        assert not set("\r\n \t@#") & set(target.host_header + target.path.split("?")[0].replace("@", ""))


def test_all_public_answers_are_handed_on_in_their_order_and_one_bad_one_or_none_refuses_all():
    target = parse_target("https://hooks.example.org/", allow_loopback=False)
    public = ("2606:4700::1111", "8.8.8.8")
    assert resolve_safely(target.host, target.port, allow_loopback=False, resolve=resolving_to(*public)) == public
    for answers in (["10.0.0.1"], ["8.8.8.8", "10.0.0.1"], ["10.0.0.1", "8.8.8.8"]):
        with pytest.raises(AddressError) as refused:
            resolve_safely(target.host, target.port, allow_loopback=False, resolve=resolving_to(*answers))
        assert "10.0.0.1" not in refused.value.message  # it would draw a map of the network
    with pytest.raises(AddressError, match="does not resolve"):
        resolve_safely(target.host, target.port, allow_loopback=False, resolve=resolving_to())


@pytest.mark.parametrize("address", ["127.0.0.1", "[::1]"])
def test_address_in_the_url_is_checked_as_a_resolved_one_is(address):
    target = parse_target(f"https://{address}/", allow_loopback=False)
    with pytest.raises(AddressError, match="not public"):
        resolve_safely(target.host, target.port, allow_loopback=False)


def test_setting_opens_127_0_0_1_and_nothing_else():
    target = parse_target("http://127.0.0.1:8000/hook", allow_loopback=True)
    assert resolve_safely(target.host, target.port, allow_loopback=True) == ("127.0.0.1",)
    for url in ("http://hooks.example.org/", "http://127.0.0.2/", "http://localhost/", "http://[::1]/"):
        with pytest.raises(AddressError):
            parse_target(url, allow_loopback=True)
    for address in ("127.0.0.2", "::1", "10.0.0.1", "169.254.169.254"):
        with pytest.raises(AddressError):
            resolve_safely(target.host, target.port, allow_loopback=True, resolve=resolving_to(address))


def test_resolver_that_hangs_or_fails_gives_no_answer(monkeypatch):
    def fails(*_, **__):
        raise socket.gaierror

    monkeypatch.setattr(socket, "getaddrinfo", fails)
    assert system_resolver("hooks.example.org", 443) == []
    monkeypatch.setattr(safe_address, "RESOLVE_SECONDS", 0.05)
    released = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: released.wait(PATIENCE_SECONDS) and [])
    assert system_resolver("hooks.example.org", 443) == []
    released.set()
