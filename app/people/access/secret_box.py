"""Uses of the server's secret key: encrypting secrets that are needed again, and keyed digests of erased ids.

Two keys are derived from TADA_SECRET_KEY by HKDF. On the embedded default the key is drawn once and
stored in the data folder, readable by its owner only; beyond one machine it must be set, since all
processes need the same key.
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
from app.db.session import Database
from app.people import privacy_queries as privacy

KEY_FILE = "secret.key"


class SecretKeyError(TadaError):
    """The secret key is missing, or is not the key that a secret was sealed with."""

    code = "secret_key_wrong"
    status = 500


class SecretBox:
    """Seals secrets and makes digests with one key.

    Cheap to create, safe to share between threads.
    """

    def __init__(self, key: str) -> None:
        self._fernet = Fernet(base64.urlsafe_b64encode(_derive_key(key, "seal")))
        self._digest_key = _derive_key(key, "name")

    def seal(self, secret: str) -> str:
        """Encrypt a secret as text that only this key opens (Fernet: AES-CBC with HMAC)."""
        return self._fernet.encrypt(secret.encode()).decode()

    def open(self, sealed: str) -> str:
        """Decrypt a sealed secret. Raises SecretKeyError if another key sealed it."""
        try:
            return self._fernet.decrypt(sealed.encode()).decode()
        except InvalidToken:
            raise SecretKeyError(
                "TADA_SECRET_KEY is not the key that this secret was sealed with."
            ) from None

    def open_recent(self, sealed: str, seconds: int) -> str | None:
        """Decrypt what a browser kept for us; None if it was not sealed here in the last so many seconds."""
        try:
            return self._fernet.decrypt(sealed.encode(), ttl=seconds).decode()
        except InvalidToken:
            return None

    def digest(self, kind: str, value: str) -> str:
        """Return the HMAC-SHA-256 (hex) of a value, which only this server can compute."""
        return hmac.new(self._digest_key, f"{kind}\0{value}".encode(), hashlib.sha256).hexdigest()


def open_secret_box(settings: Settings) -> SecretBox:
    """Create the box of these settings. Raises SecretKeyError if a key must be set and is not."""
    if settings.secret_key is not None:
        return SecretBox(settings.secret_key.get_secret_value())
    if not settings.is_embedded:
        raise SecretKeyError(
            "Set TADA_SECRET_KEY to 32 characters or more, the same for all processes: beyond one machine the server "
            "cannot draw and store a key itself."
        )
    return SecretBox(_read_or_create_key(settings.data_dir / KEY_FILE))


def existing_secret_box(settings: Settings) -> SecretBox | None:
    """Create the box of these settings; None if there is no key yet. Creates no key."""
    if settings.secret_key is None and not (settings.data_dir / KEY_FILE).exists():
        return None
    return open_secret_box(settings)


def require_same_key(database: Database, box: SecretBox) -> None:
    """Compare the key with the one that the database was first used with.

    Raises SecretKeyError if it is another one.

    With another key erased meals would not be recognised, and would be accepted again.
    """
    with database.read() as session:
        kept = privacy.key_check(session)
    if kept is not None and kept != _check_of(box):
        raise SecretKeyError(
            "TADA_SECRET_KEY is not the key that this database was first used with: set that one (without the setting "
            f"it is {KEY_FILE} in TADA_DATA_DIR)."
        )


def keep_key(database: Database, box: SecretBox) -> None:
    """Note that the database is used with this key, the first time.

    Raises SecretKeyError if it is used with another.

    To be called once all else that knows the key, such as the ledger of erasures, has been read
    with it.
    """
    with database.read() as session:
        is_kept = privacy.key_check(session) is not None
    if not is_kept:
        with database.write() as session:
            privacy.keep_key_check(session, _check_of(box))
    require_same_key(database, box)


def _check_of(box: SecretBox) -> str:
    return box.digest("check", "deployment")


def _read_or_create_key(path: Path) -> str:
    """Return the key in a file, which is created atomically if missing; of two concurrent processes one creates it."""
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


def _derive_key(key: str, purpose: str) -> bytes:
    return HKDF(
        hashes.SHA256(), length=32, salt=None, info=f"tada-server {purpose}".encode()
    ).derive(key.encode())
