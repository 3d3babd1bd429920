"""What is done with the server's secret key: sealing secrets that are needed again, and naming what was erased.

One key (TADA_SECRET_KEY), two keys derived from it by HKDF. On the embedded default the key is drawn once and kept in
the data folder, for its owner only; beyond one machine it must be given, since all processes need the same.
"""

import base64
import hashlib
import hmac
import os
import secrets
from pathlib import Path

from cryptography.fernet import Fernet, InvalidToken
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from app.core.errors import TadaError
from app.core.settings import Settings

KEY_FILE = "secret.key"


class SecretKeyError(TadaError):
    """The secret key is missing, or is not the one that this was sealed with."""

    code = "secret_key_wrong"
    status = 500


class SecretBox:
    """Seals and names under one key. Cheap to make, safe to share between threads."""

    def __init__(self, key: str) -> None:
        self._fernet = Fernet(base64.urlsafe_b64encode(_derived(key, "seal")))
        self._naming_key = _derived(key, "name")

    def seal(self, secret: str) -> str:
        """A secret as text that only this key opens (Fernet: AES-CBC with HMAC)."""
        return self._fernet.encrypt(secret.encode()).decode()

    def open(self, sealed: str) -> str:
        """The secret again. Raises SecretKeyError where another key sealed it."""
        try:
            return self._fernet.decrypt(sealed.encode()).decode()
        except InvalidToken:
            raise SecretKeyError("TADA_SECRET_KEY is not the key that this secret was sealed with.") from None

    def digest(self, kind: str, value: str) -> str:
        """HMAC-SHA-256, hex: the name of something erased, which only this server and whoever holds the id can make."""
        return hmac.new(self._naming_key, f"{kind}\0{value}".encode(), hashlib.sha256).hexdigest()


def open_secret_box(settings: Settings) -> SecretBox:
    """The box of these settings. Raises SecretKeyError where a key must be given and is not."""
    if settings.secret_key is not None:
        return SecretBox(settings.secret_key.get_secret_value())
    if not settings.is_embedded:
        raise SecretKeyError(
            "Set TADA_SECRET_KEY to 32 characters or more, the same for all processes: beyond one machine there is no "
            "place to keep a key that the server drew itself."
        )
    return SecretBox(_key_of_this_machine(settings.data_dir / KEY_FILE))


def _key_of_this_machine(path: Path) -> str:
    """The key in the file; made, whole or not at all, if it is not there. Of two processes at once one wins."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
        handle = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w") as file:
            file.write(secrets.token_urlsafe(48))
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(draft, path)
        except FileExistsError:
            pass
        finally:
            draft.unlink()
    return path.read_text(encoding="ascii").strip()


def _derived(key: str, purpose: str) -> bytes:
    return HKDF(hashes.SHA256(), length=32, salt=None, info=f"tada-server {purpose}".encode()).derive(key.encode())
