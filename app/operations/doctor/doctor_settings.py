"""Checks of the settings: insecure values, and wrong addresses for phones.

They use no network and read at most the key's file.
"""

import ipaddress
import os
import stat
from pathlib import Path
from urllib.parse import urlsplit

import sqlalchemy as sa

from app.core.errors import TadaError
from app.core.private_files import OTHERS
from app.operations.doctor.finding import Deployment, Verdict, bad, note, ok
from app.people.access.secret_box import KEY_FILE, open_secret_box

VERIFIED = frozenset({"verify-ca", "verify-full"})  # other sslmodes do not verify the server
LOCAL_HOSTS = frozenset({"127.0.0.1", "::1", "localhost"})


def look_at_secret_key(deployment: Deployment) -> Verdict:
    """Check that the secret key exists and that others cannot read it."""
    settings = deployment.settings
    path = settings.data_dir / KEY_FILE
    if settings.secret_key is None and settings.is_embedded and not path.exists():
        return note(f"{path} is not there yet: the server makes it at its first start.")
    try:
        open_secret_box(settings)
    except (TadaError, OSError) as error:
        return bad(str(error))
    if settings.secret_key is not None:
        return ok("set by TADA_SECRET_KEY")
    if stat.S_IMODE(path.stat().st_mode) & OTHERS:
        return bad(f"others on this machine may read {path}.", f"Do `chmod 600 {path}`.")
    return ok(f"in {path}; keep a copy of it outside of backups of the data")


def look_at_private_files(deployment: Deployment) -> Verdict | None:
    """Check the data folder's mode, which may predate the program's umask."""
    settings = deployment.settings
    folders = {settings.data_dir.absolute()}
    path = sa.make_url(settings.resolved_database_url).database
    if settings.is_embedded and path:
        folders.add(Path(path).absolute().parent)
    existing = sorted(folder for folder in folders if folder.is_dir())
    open_folders = [
        str(folder) for folder in existing if stat.S_IMODE(folder.stat().st_mode) & OTHERS
    ]
    if open_folders:
        advice = " ".join(["Do `chmod -R go=", *open_folders]) + "`."
        return bad(f"others on this machine may look into {' and '.join(open_folders)}.", advice)
    return ok("the data folder is for this user alone") if existing else None


def look_at_public_url(deployment: Deployment) -> Verdict | None:
    """Check the address that phones get."""
    settings, url = deployment.settings, deployment.settings.public_url
    if url is None:
        if settings.host in LOCAL_HOSTS:
            return None
        return note(
            "TADA_PUBLIC_URL is not set: phones are told the address that the caller used.",
            "Set it to https://HOST as phones reach it.",
        )
    try:
        parts = urlsplit(url)
        host = parts.hostname or ""
    except ValueError:
        host = ""
    if not host or parts.scheme not in ("http", "https") or url.endswith("/"):
        return bad(f"TADA_PUBLIC_URL is {url!r}.", "Write it like https://tada.example.org.")
    if parts.scheme == "http" and host not in LOCAL_HOSTS:
        return bad(
            f"{url} is not encrypted: tokens and photographs go through the net in the clear.",
            "Put a proxy with TLS before the server and set TADA_PUBLIC_URL to its https address.",
        )
    return ok(url)


def look_at_way_to_database(deployment: Deployment) -> Verdict | None:
    """Check that the connection to the database is encrypted and verified."""
    database = sa.make_url(deployment.settings.resolved_database_url)
    host = str(database.query.get("host", database.host or ""))
    if deployment.settings.is_embedded or not host or host in LOCAL_HOSTS or host.startswith("/"):
        return None
    mode = database.query.get("sslmode", os.environ.get("PGSSLMODE", "prefer"))
    if mode in VERIFIED:
        return ok(f"TLS, sslmode={mode}")
    return (bad if _is_elsewhere(host) else note)(
        f"records and passwords may go to {host} in the clear, or to somebody else (sslmode={mode}).",
        "Add ?sslmode=verify-full&sslrootcert=FILE (or =system) to TADA_DATABASE_URL.",
    )


def look_at_way_to_store(deployment: Deployment) -> Verdict | None:
    """Check that photographs are not sent to the store unencrypted."""
    endpoint = urlsplit(deployment.settings.s3_endpoint or "")
    if endpoint.scheme != "http" or not _is_elsewhere(endpoint.hostname):
        return None
    return bad(
        f"photographs go to {endpoint.hostname} in the clear.",
        "Give TADA_S3_ENDPOINT an https address.",
    )


def look_at_proxies(deployment: Deployment) -> Verdict | None:
    """Check the trusted proxies; report the first invalid one."""
    settings = deployment.settings
    proxies = [
        proxy.strip() for proxy in (settings.trusted_proxies or "").split(",") if proxy.strip()
    ]
    for proxy in proxies:
        try:
            is_every_address = ipaddress.ip_network(proxy).prefixlen == 0
        except ValueError:
            return bad(
                f"TADA_TRUSTED_PROXIES: {proxy!r} is not a network.",
                "Write it like 10.0.0.5 or 10.0.0.0/24.",
            )
        if is_every_address:
            return bad(
                f"TADA_TRUSTED_PROXIES: {proxy} covers all addresses: any client could claim any address.",
                "Give the proxies' own addresses.",
            )
    if proxies or not (settings.public_url or "").startswith("https://"):
        return None
    return note(
        "TADA_TRUSTED_PROXIES is not set: behind a proxy all phones count as one address against the limits.",
        "Set it to the address of the proxy that ends TLS.",
    )


def look_at_webhook_addresses(deployment: Deployment) -> Verdict | None:
    """Check that webhooks cannot reach this machine's services."""
    if not deployment.settings.webhook_allow_loopback:
        return None
    return bad(
        "TADA_WEBHOOK_ALLOW_LOOPBACK lets webhooks reach this machine's own services.",
        "It is for tests only: unset it.",
    )


def look_at_metrics(deployment: Deployment) -> Verdict | None:
    """Check that a proxy does not expose the metrics."""
    settings = deployment.settings
    if settings.metrics_token is not None or not (settings.trusted_proxies or settings.public_url):
        return None
    return note(
        "TADA_METRICS_TOKEN is not set: a proxy on this machine that adds no X-Forwarded-For (nginx, unless told "
        "otherwise) looks like a caller from here, so everybody may read /metrics through it.",
        "Set it, or see that the proxy does not pass /metrics on, as docker/Caddyfile does.",
    )


def _is_elsewhere(host: str | None) -> bool:
    """Return whether a host is outside this machine and its container network, whose host names have no dot."""
    return host is not None and host not in LOCAL_HOSTS and ("." in host or ":" in host)
