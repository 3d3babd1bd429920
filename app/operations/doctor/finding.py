"""What the checks of `tada doctor` are given (Deployment) and what they say (Finding)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from app.core.settings import Settings
from app.db.session import Database
from app.jobs.leases import living_workers
from app.operations.figure_queries import Figures, figures
from app.people.access.secret_box import KEY_FILE, SecretBox, open_secret_box
from app.privacy.erasure_ledger import ErasureLedger
from app.storage.blob_store import BlobStore
from app.storage.opening import open_blob_store

Level = Literal["ok", "note", "bad"]
LISTED = 5  # names shown of a longer list


@dataclass(frozen=True, slots=True)
class Finding:
    """level bad: something is wrong; note: right as it may be, and worth knowing. advice: what to do about it."""

    subject: str
    level: Level
    message: str
    advice: str = ""

    @property
    def is_ok(self) -> bool:
        """Whether nothing is wrong."""
        return self.level != "bad"

    def __str__(self) -> str:
        words = {"ok": "ok  ", "note": "note", "bad": "BAD "}[self.level]
        return f"{words} {self.subject}: {self.message}" + (f" {self.advice}" if self.advice else "")


Verdict = tuple[Level, str, str]  # level, message, advice


def ok(message: str) -> Verdict:
    """Return that nothing is wrong; the message is no sentence."""
    return "ok", message, ""


def note(message: str, advice: str = "") -> Verdict:
    """Return that something is worth knowing, in a sentence."""
    return "note", message, advice


def bad(message: str, advice: str = "") -> Verdict:
    """Return what is wrong, in a sentence, and what to do about it."""
    return "bad", message, advice


@dataclass(frozen=True)
class Deployment:
    """What is examined. requeue: whether to queue meals again that nothing will move."""

    database: Database
    settings: Settings
    requeue: bool

    @cached_property
    def blobs(self) -> BlobStore:
        """The store of photographs."""
        return open_blob_store(self.settings.resolved_blob_url, self.settings)

    @cached_property
    def erasures(self) -> BlobStore:
        """The store of the ledger of erasures."""
        return open_blob_store(self.settings.resolved_erasure_url, self.settings)

    @cached_property
    def box(self) -> SecretBox | None:
        """None where there is no secret key yet, and so nothing sealed."""
        if self.settings.secret_key is None and not (self.settings.data_dir / KEY_FILE).exists():
            return None
        return open_secret_box(self.settings)

    @cached_property
    def ledger(self) -> ErasureLedger | None:
        """None where there is no secret key yet."""
        return ErasureLedger(self.erasures, self.box) if self.box is not None else None

    @cached_property
    def figures(self) -> Figures:
        """What waits, as /metrics has it."""
        with self.database.read() as session:
            return figures(session)

    @cached_property
    def worker_versions(self) -> list[str]:
        """The version of each living worker."""
        return [worker.version for worker in living_workers(self.database)]


def some(names: list[str]) -> str:
    """The first of the names."""
    return ", ".join(names[:LISTED]) + (" ..." if len(names) > LISTED else "")
