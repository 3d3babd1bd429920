"""What `tada doctor` says of one thing that it looked at."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "note", "bad"]


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
