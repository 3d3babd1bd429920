"""A real OpenID provider on a socket of this machine (oidc-provider-mock, on authlib), which can be made to lie.

It does not ask for PKCE, so what stands before it here does, and counts the codes that it hands out.
"""

import base64
import contextlib
import hashlib
import hmac
import io
import json
import threading
import warnings
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qs, urlsplit

from joserfc import jwt
from joserfc.jwk import KeySet, RSAKey
from werkzeug.serving import WSGIRequestHandler, make_server

with warnings.catch_warnings():
    import authlib.deprecate  # noqa: F401  # shows its own warnings, whatever the filters before say

    warnings.simplefilter("ignore")
    from oidc_provider_mock import app as provider_app

# of authlib, about what the provider uses of it: for the tests' pytestmark
FILTER = "ignore::DeprecationWarning:(authlib|oidc_provider_mock)"

CLIENT, SECRET = "tada", "the:client's/own+secret"


@dataclass
class IdentityProvider:
    """The provider.

    claims, algorithm: what its ID tokens say instead; "other key": signed by a key that it does not publish.
    answers: path -> a body that it answers instead.
    """

    address: str = ""
    claims: dict[str, Any] = field(default_factory=dict)
    algorithm: str | None = None
    answers: dict[str, bytes] = field(default_factory=dict)
    calls: list[str] = field(default_factory=list)
    _challenges: dict[str, str] = field(default_factory=dict)
    _key: RSAKey = field(default_factory=lambda: RSAKey.generate_key(2048, {"kid": "ours"}))
    _app: Any = field(default_factory=lambda: provider_app(require_nonce=True))

    def __call__(self, environ, start_response):
        """As WSGI calls it."""
        path, query = environ["PATH_INFO"], parse_qs(environ["QUERY_STRING"])
        body = environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        environ["wsgi.input"] = io.BytesIO(body)
        self.calls.append(path)
        if path in self.answers:
            start_response("200 OK", [("Content-Type", "application/json")])
            return [self.answers[path]]
        if path == "/oauth2/token" and (refusal := self._refusal(environ, parse_qs(body.decode()))):
            start_response("400 Bad Request", [("Content-Type", "application/json")])
            return [json.dumps({"error": refusal}).encode()]
        head = []
        content = b"".join(self._app(environ, lambda status, headers, *_: head.extend((status, headers))))
        status, headers = head
        location = dict(headers).get("Location", "")
        for code in parse_qs(urlsplit(location).query).get("code", []):
            self._challenges[code] = query["code_challenge"][0]
            assert query["code_challenge_method"] == ["S256"]
        if path == "/jwks" and self._lies:
            content = json.dumps(KeySet([self._key]).as_dict()).encode()
        elif path == "/oauth2/token" and self._lies and status.startswith("200"):
            answer = json.loads(content)
            content = json.dumps(answer | {"id_token": self._lie(answer["id_token"])}).encode()
        start_response(status, [(name, value) for name, value in headers if name.lower() != "content-length"])
        return [content]

    @property
    def _lies(self):
        return bool(self.claims or self.algorithm)

    def _refusal(self, environ, form):
        expected = base64.b64encode(b"tada:the%3Aclient%27s%2Fown%2Bsecret").decode()
        if environ.get("HTTP_AUTHORIZATION") != f"Basic {expected}":
            return "invalid_client"
        digest = hashlib.sha256(form["code_verifier"][0].encode()).digest()
        challenge = self._challenges.pop(form.get("code", [""])[0], None)
        if challenge != _base64(digest).decode():
            return "invalid_grant"
        return None

    def _lie(self, token):
        part = token.split(".")[1]
        true_claims = json.loads(base64.urlsafe_b64decode(part + "=" * (-len(part) % 4)))
        claims = {name: value for name, value in (true_claims | self.claims).items() if value is not None}
        if self.algorithm in ("none", "HS256"):  # the latter with what everybody can read as the secret
            head = {"alg": self.algorithm, "kid": "ours"}
            signed = b".".join(_base64(json.dumps(part).encode()) for part in (head, claims))
            digest = hmac.digest(self._key.as_pem(private=False), signed, "sha256")
            return (signed + b"." + (_base64(digest) if self.algorithm == "HS256" else b"")).decode()
        key = RSAKey.generate_key(2048) if self.algorithm == "other key" else self._key
        return jwt.encode({"alg": "RS256", "kid": "ours"}, claims, key)


def _base64(content):
    return base64.urlsafe_b64encode(content).rstrip(b"=")


class _Silent(WSGIRequestHandler):
    def log(self, *_):
        pass


@contextlib.contextmanager
def identity_provider():
    """Yield the provider, serving."""
    provider = IdentityProvider()
    server = make_server("127.0.0.1", 0, provider, threaded=True, request_handler=_Silent)
    provider.address = f"http://localhost:{server.port}"  # another site than 127.0.0.1
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield provider
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
