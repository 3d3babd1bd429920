"""Forwarded addresses: believed from the named proxies and from nobody else, by uvicorn's own middleware."""

import asyncio

import pytest
from fastapi import FastAPI, Request

from app.cli.serving import check_public_url, listen, server_config, trusted_proxies
from app.core.errors import InvalidInputError, RateLimitedError, UnavailableError
from app.core.settings import Settings
from app.http.rate_limit import RateLimit, caller_address

CALLER, PROXY = "198.51.100.7", "10.0.0.5"


def limited_app(limit):
    app = FastAPI()

    @app.get("/")
    def count(request: Request):
        try:
            limit.take(caller_address(request))
        except RateLimitedError:
            return {"limited": True}
        return {"address": caller_address(request), "scheme": request.url.scheme}

    return app


def asked(loaded_app, client, *headers):
    """The answer to a request of a real ASGI scope, as uvicorn would make it."""
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "GET",
        "path": "/",
        "raw_path": b"/",
        "query_string": b"",
        "root_path": "",
        "scheme": "http",
        "server": ("127.0.0.1", 8000),
        "client": (client, 50_000),
        "headers": [(b"host", b"tada")] + [(name.encode(), value.encode()) for name, value in headers],
    }
    sent = []

    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message):
        sent.append(message)

    asyncio.run(loaded_app(scope, receive, send))
    return b"".join(message.get("body", b"") for message in sent).decode()


def served(proxies, per_minute=1000):
    config = server_config(Settings(trusted_proxies=proxies), limited_app(RateLimit(per_minute)))
    config.load()
    return config.loaded_app


@pytest.mark.parametrize(("client", "proxies"), [(CALLER, None), ("127.0.0.1", ""), ("::1", PROXY)])
def test_forged_address_does_not_escape_the_limit(client, proxies, monkeypatch):
    monkeypatch.setenv("FORWARDED_ALLOW_IPS", "*")  # uvicorn's own variable has no say
    app = served(proxies, per_minute=2)
    answers = [asked(app, client, ("x-forwarded-for", f"192.0.2.{n}")) for n in range(3)]
    assert "limited" in answers[2]
    assert "192.0.2" not in "".join(answers)


def test_named_proxy_tells_who_calls_and_by_which_scheme_and_of_several_the_last_stranger_calls():
    app = served(f"{PROXY}, 10.1.0.0/24")
    answer = asked(app, "10.1.0.9", ("x-forwarded-for", CALLER), ("x-forwarded-proto", "https"))
    assert f'"{CALLER}"' in answer
    assert '"https"' in answer
    app = served(PROXY, per_minute=2)
    answers = [asked(app, PROXY, ("x-forwarded-for", f"192.0.2.{n}, {CALLER}")) for n in range(3)]
    assert "limited" in answers[2]
    app = served("10.0.0.0/8")
    assert f'"{CALLER}"' in asked(app, PROXY, ("x-forwarded-for", f"192.0.2.1, {CALLER}, 10.9.9.9"))
    assert f'"{CALLER}"' in asked(app, PROXY, ("x-forwarded-for", "192.0.2.1"), ("x-forwarded-for", CALLER))


@pytest.mark.parametrize("wrong", ["proxy.example.org", "*", "10.0.0.1/8", "0.0.0.0/0", "::/0", "10.0.0.5;10.0.0.6"])
def test_what_names_no_proxy_stops_the_start_with_a_sentence(wrong):
    with pytest.raises(InvalidInputError, match="TADA_TRUSTED_PROXIES") as caught:
        trusted_proxies(wrong)
    assert caught.value.code == "settings_invalid"
    fine = ["10.0.0.5", "10.1.0.0/24", "fd00::1", "fd00:1::/64"]
    assert trusted_proxies(" 10.0.0.5 ,10.1.0.0/24,, fd00::1,fd00:1::/64") == fine


@pytest.mark.parametrize(
    ("client", "counted"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("::ffff:192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("testclient", "testclient"),
    ],
)
def test_ipv6_callers_count_by_their_home_network(client, counted):
    assert f'"{counted}"' in asked(served(None), client)


@pytest.mark.parametrize(
    "wrong",
    ["tada.example.org", "ftp://x", "https://", "https://x/", "https://a:b@x", "https://x?y=1", "https://x:99999"],
)
def test_public_url_that_no_phone_could_use_stops_the_start(wrong):
    with pytest.raises(InvalidInputError, match="TADA_PUBLIC_URL"):
        check_public_url(wrong)
    for fine in (None, "https://tada.example.org", "http://10.0.0.2:8000", "https://x.org/tada"):
        check_public_url(fine)


def test_address_that_is_in_use_is_refused_and_nothing_stays_open():
    (listening,) = listen("127.0.0.1", 0)
    with listening, pytest.raises(UnavailableError, match="Address already in use"):
        listen(*listening.getsockname())
