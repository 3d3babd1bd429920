"""Input (Deployment) and results (Finding) of the checks of `tada doctor`."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from app.core.settings import Settings
from app.db.session import Database
from app.jobs.leases import living_workers
from app.operations.queries import Figures, figures
from app.people.access.secret_box import SecretBox, existing_secret_box
from app.privacy.erasure_ledger import ErasureLedger
from app.storage.blob_store import BlobStore
from app.storage.opening import open_blob_store

Level = Literal["ok", "note", "bad"]
LISTED = 5  # names shown of a longer list


@dataclass(frozen=True, slots=True)
class Finding:
    """level bad: a problem; note: not a problem, but worth knowing. advice: the remedy."""

    subject: str
    level: Level
    message: str
    advice: str = ""

    @property
    def is_ok(self) -> bool:
        """Return whether there is no problem."""
        return self.level != "bad"

    def __str__(self) -> str:
        label = {"ok": "ok  ", "note": "note", "bad": "BAD "}[self.level]
        return f"{label} {self.subject}: {self.message}" + (
            f" {self.advice}" if self.advice else ""
        )


Verdict = tuple[Level, str, str]  # level, message, advice


def ok(message: str) -> Verdict:
    """Return a verdict without a problem; the message is a phrase."""
    return "ok", message, ""


def note(message: str, advice: str = "") -> Verdict:
    """Return a verdict worth knowing; the message is a sentence."""
    return "note", message, advice


def bad(message: str, advice: str = "") -> Verdict:
    """Return a problem; the message and the advice are sentences."""
    return "bad", message, advice


@dataclass(frozen=True)
class Deployment:
    """The examined deployment. requeue: whether to queue stuck meals again."""

    database: Database
    settings: Settings
    requeue: bool

    @cached_property
    def blobs(self) -> BlobStore:
        """Return the store of photographs."""
        return open_blob_store(self.settings.resolved_blob_url, self.settings)

    @cached_property
    def erasures(self) -> BlobStore:
        """Return the store of the ledger of erasures."""
        return open_blob_store(self.settings.resolved_erasure_url, self.settings)

    @cached_property
    def box(self) -> SecretBox | None:
        """Return the secret box; None if there is no secret key yet, and so nothing is sealed."""
        return existing_secret_box(self.settings)

    @cached_property
    def ledger(self) -> ErasureLedger | None:
        """Return the ledger of erasures; None if there is no secret key yet."""
        return ErasureLedger(self.erasures, self.box) if self.box is not None else None

    @cached_property
    def figures(self) -> Figures:
        """Return the figures of /metrics."""
        with self.database.read() as session:
            return figures(session)

    @cached_property
    def worker_versions(self) -> list[str]:
        """Return the version of each running worker."""
        return [worker.version for worker in living_workers(self.database)]


def some(names: list[str]) -> str:
    """Return the first of the names as text."""
    return ", ".join(names[:LISTED]) + (" ..." if len(names) > LISTED else "")
