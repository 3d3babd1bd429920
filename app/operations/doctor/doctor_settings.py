"""Checks of the settings: insecure values, wrong addresses for phones, what names foods.

They use no network and read at most the key's file. Foods are named by an operator's index and
network.
"""

import ipaddress
import os
import stat
from collections.abc import Collection
from pathlib import Path
from urllib.parse import urlsplit

import sqlalchemy as sa

from app.candidates.classify import (
    CLASSIFIER_SECONDS,
    FoodClassifier,
    classify_request,
    failure_of,
    read_classifier,
)
from app.children.api_children import TASKS
from app.children.child_pool import ChildPool, ChildStartError
from app.core.errors import Failure, TadaError
from app.core.process_life import OTHERS
from app.core.settings import Settings
from app.foods import queries as foods
from app.identification.food_index import open_index
from app.operations.doctor.finding import LISTED, Deployment, Verdict, bad, note, ok
from app.people.access.secret_box import KEY_FILE, open_secret_box
from app.vision.looks.vcm import VCM_VERSION

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


def look_at_food_index(deployment: Deployment) -> Verdict | None:
    """Check that the operator's index can be read and used, and that the food table has its foods."""
    path = deployment.settings.food_index
    if path is None:
        return None
    try:
        index = open_index(path)
    except TadaError as error:
        return bad(
            f"{error.message} Meals get no candidates.", "Build it again by `tada index build`."
        )
    if index.vcm_version != VCM_VERSION:
        return bad(
            f"{path} was built for vectors of version {index.vcm_version}, not {VCM_VERSION}: meals get no candidates.",
            "Build it again by `tada index build`.",
        )
    keys = {food.food_key for food in index.foods}
    return _unknown_foods(deployment, keys) or ok(f"{index.version}: {len(keys)} foods")


def look_at_classifier(deployment: Deployment) -> Verdict | None:
    """Check the operator's network: file and digest, that it loads and fits its description, and its foods."""
    path = deployment.settings.classifier
    if path is None:
        return None
    classifier = read_classifier(path)
    failure = (
        classifier
        if isinstance(classifier, Failure)
        else _try_network(classifier, deployment.settings)
    )
    if isinstance(classifier, Failure) or failure is not None:
        message = failure.message if failure is not None else ""
        return bad(
            f"{message} Meals get the candidates of the index alone.",
            "Correct TADA_CLASSIFIER or unset it.",
        )
    keys = {key for key in classifier.food_keys if key is not None}
    return _unknown_foods(deployment, keys) or ok(f"{classifier.version}: {len(keys)} foods")


def _try_network(classifier: FoodClassifier, settings: Settings) -> Failure | None:
    """Load the network in a limited child and show it a grey picture; None: it answers as described."""
    children = ChildPool(settings, TASKS)
    try:
        request = classify_request(classifier, Path(), [], max_pixels=settings.max_photo_pixels)
        return failure_of(children.run(request, lambda _: None, seconds=CLASSIFIER_SECONDS))
    except ChildStartError as error:
        return Failure(
            "classifier_crashed", f"No process could be started to try the model: {error}."
        )
    finally:
        children.close()


def _unknown_foods(deployment: Deployment, keys: Collection[str]) -> Verdict | None:
    """Note the foods that cannot be chosen."""
    with deployment.database.read() as session:
        unknown = sorted(set(keys) - foods.foods_by_key(session, keys).keys())
    if not unknown:
        return None
    return note(
        f"{len(unknown)} of its {len(keys)} foods are in no food table in force: {', '.join(unknown[:LISTED])}.",
        "They are no candidates until a table has foods with these keys.",
    )
