"""What `tada doctor` says of the settings themselves: what would let others in, or tell phones a wrong address."""

import ipaddress
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import sqlalchemy as sa

from app.errors import TadaError
from app.private_files import OTHERS
from app.services.finding import Finding
from app.services.secret_box import KEY_FILE, open_secret_box
from app.settings import Settings

VERIFIED = frozenset({"verify-ca", "verify-full"})  # other sslmodes speak to whoever answers
LOCAL_HOSTS = frozenset({"127.0.0.1", "::1", "localhost"})


def look_at_settings(settings: Settings) -> Iterator[Finding]:
    """Asks nobody; reads the key's file at most."""
    yield _secret_key(settings)
    yield from _private_files(settings)
    yield from _public_url(settings)
    yield from _ways_inside(settings)
    yield from _proxies(settings)
    yield from _doors(settings)


def _secret_key(settings: Settings) -> Finding:
    subject = "secret key"
    path = settings.data_dir / KEY_FILE
    if settings.secret_key is None and settings.is_embedded and not path.exists():
        return Finding(subject, "note", f"{path} is not there yet: the server makes it at its first start.")
    try:
        open_secret_box(settings)
    except (TadaError, OSError) as error:
        return Finding(subject, "bad", str(error))
    if settings.secret_key is not None:
        return Finding(subject, "ok", "set by TADA_SECRET_KEY")
    if stat.S_IMODE(path.stat().st_mode) & 0o077:
        return Finding(subject, "bad", f"others on this machine may read {path}.", f"Do `chmod 600 {path}`.")
    return Finding(subject, "ok", f"in {path}; keep a copy of it outside of backups of the data")


def _private_files(settings: Settings) -> Iterator[Finding]:
    """Older versions left the data folder to the shell's umask, mostly readable by every local user."""
    subject, folders = "private files", {settings.data_dir.absolute()}
    if settings.is_embedded and (path := sa.make_url(settings.resolved_database_url).database):
        folders.add(Path(path).absolute().parent)
    seen = sorted(folder for folder in folders if folder.is_dir())
    open_ones = [str(folder) for folder in seen if stat.S_IMODE(folder.stat().st_mode) & OTHERS]
    if open_ones:
        told = " and ".join(open_ones)
        advice = " ".join(["Do `chmod -R go=", *open_ones]) + "`."
        yield Finding(subject, "bad", f"others on this machine may look into {told}.", advice)
    elif seen:
        yield Finding(subject, "ok", "the data folder is for this user alone")


def _public_url(settings: Settings) -> Iterator[Finding]:
    subject, url = "public url", settings.public_url
    if url is None:
        if settings.host not in LOCAL_HOSTS:
            yield Finding(
                subject,
                "note",
                "TADA_PUBLIC_URL is not set: phones are told the address that the caller used.",
                "Set it to https://HOST as phones reach it.",
            )
        return
    try:
        parts = urlsplit(url)
        host = parts.hostname or ""
    except ValueError:
        host = ""
    if not host or parts.scheme not in ("http", "https") or url.endswith("/"):
        yield Finding(subject, "bad", f"TADA_PUBLIC_URL is {url!r}.", "Write it like https://tada.example.org.")
    elif parts.scheme == "http" and host not in LOCAL_HOSTS:
        yield Finding(
            subject,
            "bad",
            f"{url} is not encrypted: tokens and photographs go through the net in the clear.",
            "Put a proxy with TLS before the server and set TADA_PUBLIC_URL to its https address.",
        )
    else:
        yield Finding(subject, "ok", url)


def _ways_inside(settings: Settings) -> Iterator[Finding]:
    """To database and store: what is told to them is as private as what phones send."""
    database = sa.make_url(settings.resolved_database_url)
    host = str(database.query.get("host", database.host or ""))
    if not settings.is_embedded and host and host not in LOCAL_HOSTS and not host.startswith("/"):
        mode = database.query.get("sslmode", os.environ.get("PGSSLMODE", "prefer"))
        if mode in VERIFIED:
            yield Finding("way to the database", "ok", f"TLS, sslmode={mode}")
        else:
            yield Finding(
                "way to the database",
                "bad" if _is_elsewhere(host) else "note",
                f"records and passwords may go to {host} in the clear, or to somebody else (sslmode={mode}).",
                "Add ?sslmode=verify-full&sslrootcert=FILE (or =system) to TADA_DATABASE_URL.",
            )
    endpoint = urlsplit(settings.s3_endpoint or "")
    if endpoint.scheme == "http" and _is_elsewhere(endpoint.hostname):
        yield Finding(
            "way to the store",
            "bad",
            f"photographs go to {endpoint.hostname} in the clear.",
            "Give TADA_S3_ENDPOINT an https address.",
        )


def _is_elsewhere(host: str | None) -> bool:
    """Whether a host is beyond this machine and the network of its containers, whose names have no dot."""
    return host is not None and host not in LOCAL_HOSTS and ("." in host or ":" in host)


def _proxies(settings: Settings) -> Iterator[Finding]:
    subject, said = "proxies", settings.trusted_proxies
    words = [word.strip() for word in (said or "").split(",") if word.strip()]
    for word in words:
        try:
            is_everybody = ipaddress.ip_network(word).prefixlen == 0
        except ValueError:
            yield Finding(
                subject,
                "bad",
                f"TADA_TRUSTED_PROXIES: {word!r} is no network.",
                "Write it like 10.0.0.5 or 10.0.0.0/24.",
            )
        else:
            if is_everybody:
                yield Finding(
                    subject,
                    "bad",
                    f"TADA_TRUSTED_PROXIES: {word} is everybody: anybody could claim any address.",
                    "Name the proxies' own addresses.",
                )
    if not words and (settings.public_url or "").startswith("https://"):
        yield Finding(
            subject,
            "note",
            "TADA_TRUSTED_PROXIES is not set: behind a proxy all phones count as one address against the limits.",
            "Set it to the address of the proxy that ends TLS.",
        )


def _doors(settings: Settings) -> Iterator[Finding]:
    if settings.webhook_allow_loopback:
        yield Finding(
            "webhooks' addresses",
            "bad",
            "TADA_WEBHOOK_ALLOW_LOOPBACK lets webhooks reach this machine's own services.",
            "It is for tests only: unset it.",
        )
    if settings.metrics_token is None and (settings.trusted_proxies or settings.public_url):
        yield Finding(
            "metrics",
            "note",
            "TADA_METRICS_TOKEN is not set: a proxy on this machine that adds no X-Forwarded-For (nginx, unless told "
            "otherwise) looks like a caller from here, so everybody may read /metrics through it.",
            "Set it, or see that the proxy does not pass /metrics on, as docker/Caddyfile does.",
        )
