"""Signing in with an account of the staff's institution: OpenID Connect, by authorization code and PKCE.

`begin` gives the address of the provider's page, and the flow that the browser keeps, sealed, in a
cookie; `identify` ends it. Nothing is kept here meanwhile, nor between two flows: the provider's
description and keys are read each time. It creates no staff: a signed-in person links the account.
"""

import base64
import hashlib
import json
import secrets
import ssl
import threading
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import quote, urlencode

import structlog
from joserfc import jwt
from joserfc.errors import JoseError
from joserfc.jwk import KeySet
from pydantic import BaseModel, ValidationError
from starlette.requests import Request

from app.core.errors import ConflictError, NotFoundError, UnauthenticatedError, UnavailableError
from app.core.settings import Settings
from app.db.session import Database, unless_taken
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import StaffCaller, sha256_hex
from app.people.access.page_rules import PREFIX, server_address
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import add_session
from app.people.access.staff_schemas import SessionIssued
from app.people.models import Staff

log = structlog.get_logger()

RETURN = f"{PREFIX}/sign-in/return"
FLOW_SECONDS = 600  # for signing in at the provider, perhaps with a second factor there
ALGORITHMS = ("RS256", "PS256", "ES256")  # with public keys only: no secret, and never none
LEEWAY_SECONDS = 60  # between the provider's clock and ours
STEP_SECONDS = 5.0  # for connecting, and for each part of an answer
MAX_ANSWER_BYTES = 512 * 1024
MAX_CONCURRENT = 8  # flows that wait for the provider; each holds a thread of the server
_calls = threading.BoundedSemaphore(MAX_CONCURRENT)


@dataclass(frozen=True, slots=True)
class Provider:
    """The institution's provider. callback: our address to which it sends browsers back."""

    issuer: str
    client_id: str
    client_secret: str
    callback: str


class Flow(BaseModel):
    """A sign-in at the provider as the browser keeps it.

    links: the session whose person links the account; None: to sign in
    """

    state: str
    nonce: str
    verifier: str
    next: str
    links: uuid.UUID | None


def provider_of(request: Request, settings: Settings) -> Provider:
    """Return the provider of the settings. Raises NotFoundError."""
    issuer, client_id, secret = (
        settings.oidc_issuer,
        settings.oidc_client_id,
        settings.oidc_client_secret,
    )
    if not issuer or not client_id or not secret:
        raise NotFoundError("This server has no sign-in by an institution.")
    callback = server_address(request, settings) + RETURN
    return Provider(issuer, client_id, secret.get_secret_value(), callback)


def begin(provider: Provider, next_path: str, links: uuid.UUID | None) -> tuple[str, Flow]:
    """Return the address of the provider's page, and the flow. Raises UnavailableError."""
    state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(3))
    challenge = hashlib.sha256(verifier.encode()).digest()
    query = {
        "response_type": "code",
        "scope": "openid",
        "client_id": provider.client_id,
        "redirect_uri": provider.callback,
        "state": state,
        "nonce": nonce,
        "code_challenge": base64.urlsafe_b64encode(challenge).rstrip(b"=").decode(),
        "code_challenge_method": "S256",
    }
    page = _description(provider)["authorization_endpoint"]
    flow = Flow(state=state, nonce=nonce, verifier=verifier, next=next_path, links=links)
    return f"{page}{'&' if '?' in page else '?'}{urlencode(query)}", flow


def open_flow(box: SecretBox, sealed: str, state: str) -> Flow:
    """Return the flow that the browser has kept. Raises UnauthenticatedError (`oidc_expired`)."""
    text = box.open_recent(sealed, FLOW_SECONDS)
    try:
        flow = Flow.model_validate_json(text or "")
    except ValidationError:
        flow = None
    if flow is None or not secrets.compare_digest(flow.state.encode(), state.encode()):
        raise expired()
    return flow


def expired() -> UnauthenticatedError:
    """Return the error for a browser that brings back no flow of its own."""
    return UnauthenticatedError(
        "This took too long, or was begun in another browser: begin again.", code="oidc_expired"
    )


def identify(provider: Provider, flow: Flow, code: str) -> str:
    """Return the person's identity: SHA-256 of issuer and subject.

    Raises UnauthenticatedError (`oidc_refused`), UnavailableError.
    """
    description = _description(provider)
    form = {
        "grant_type": "authorization_code",
        "code": code,
        "redirect_uri": provider.callback,
        "code_verifier": flow.verifier,
    }
    client = quote(provider.client_id, safe=""), quote(provider.client_secret, safe="")
    answer = _call("POST", description["token_endpoint"], data=form, auth=client)
    keys: Any = _call("GET", description["jwks_uri"])
    claims = jwt.JWTClaimsRegistry(
        leeway=LEEWAY_SECONDS,
        iss={"essential": True, "value": provider.issuer},
        aud={"essential": True, "value": provider.client_id},
        azp={"value": provider.client_id},
        nonce={"essential": True, "value": flow.nonce},
        sub={"essential": True},
        exp={"essential": True},
        iat={"essential": True},
    )
    try:
        token = jwt.decode(answer["id_token"], KeySet.import_key_set(keys), ALGORITHMS)
        claims.validate(token.claims)
    except (JoseError, LookupError, TypeError, ValueError) as error:
        log.warning("oidc_refused", provider=answer.get("error"), reason=str(error)[:200])
        raise UnauthenticatedError(
            "Your institution did not confirm who you are: begin again.", code="oidc_refused"
        ) from None
    return sha256_hex(f"{provider.issuer}\n{token.claims['sub']}")


def open_session(database: Database, identity: str) -> SessionIssued:
    """Open a session of the person who linked this identity.

    Raises UnauthenticatedError (`oidc_unlinked`).
    """
    with database.write() as session:
        staff = people.find_staff_by_identity(session, identity)
        if staff is None or staff.disabled_at is not None:
            raise UnauthenticatedError(
                "This account of your institution is not linked to one here. Sign in with your password, then link it "
                "on the page Account.",
                code="oidc_unlinked",
            )
        return add_session(session, staff, datetime.now(UTC), by="oidc")


def link(database: Database, caller: StaffCaller, identity: str | None) -> None:
    """Let the caller sign in by this identity from now on; None: by none.

    Raises ConflictError (`oidc_taken`).
    """
    taken = ConflictError(
        "This account of your institution is linked to somebody else here.", code="oidc_taken"
    )
    with unless_taken(taken), database.write() as session:
        staff = session.get_one(Staff, caller.staff_id)
        staff.oidc_identity = identity
        note(session, caller, "staff.oidc", subject=staff.name, is_linked=identity is not None)


def _description(provider: Provider) -> dict[str, Any]:
    """Read the provider's description of itself (OpenID Connect Discovery 1.0)."""
    address = f"{provider.issuer.rstrip('/')}/.well-known/openid-configuration"
    description = _call("GET", address)
    needed = {"authorization_endpoint", "token_endpoint", "jwks_uri"}
    if description.get("issuer") != provider.issuer or not needed <= description.keys():
        raise _unavailable(f"{address} does not describe {provider.issuer}")
    return description


def _call(method: str, url: str, **content: Any) -> dict[str, Any]:
    """Return the JSON object that an address of the provider answers, whatever the status."""
    import httpx2  # noqa: PLC0415  # only loaded if used

    if not _calls.acquire(blocking=False):
        raise _unavailable("too many people are signing in")
    body = b""
    try:
        with (
            httpx2.Client(
                timeout=STEP_SECONDS, trust_env=False, verify=ssl.create_default_context()
            ) as client,
            client.stream(method, url, **content) as answer,
        ):
            for part in answer.iter_bytes():
                body += part
                if len(body) > MAX_ANSWER_BYTES:
                    raise _unavailable(f"{url} answers with more than {MAX_ANSWER_BYTES} bytes")
        return dict(json.loads(body))
    except (httpx2.HTTPError, httpx2.InvalidURL, TypeError, ValueError) as error:
        raise _unavailable(f"{url}: {error!r}") from error
    finally:
        _calls.release()


def _unavailable(reason: str) -> UnavailableError:
    log.warning("oidc_unavailable", reason=reason[:300])
    return UnavailableError("Your institution's sign-in does not answer at present.")
