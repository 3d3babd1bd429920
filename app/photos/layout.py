"""What the readers of the four formats return, and how they report damage: all files are a row of typed parts."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from app.core.errors import Failure

SEND_AGAIN = "Send the file again, byte for byte as the camera saved it."


@dataclass(frozen=True, slots=True)
class Part:
    """A chunk's, segment's or box's type, and where its data start and end: without length, type and checksum."""

    kind: bytes
    start: int
    end: int


@dataclass(slots=True)
class Layout:
    """What was read, up to the end or the damage; `end` is the first byte that was not read. scans: of a JPEG."""

    end: int = 0
    parts: list[Part] = field(default_factory=list)
    width: int = 0
    height: int = 0
    damage: Failure | None = None
    scans: int = 1


class DamageError(Exception):
    """Ends the reading of a file at the damage; never leaves the readers."""

    def __init__(self, damage: Failure) -> None:
        super().__init__(damage.message)
        self.damage = damage


@contextmanager
def damage_recorded(layout: Layout) -> Iterator[None]:
    """Keep the damage at which the block ends in the layout."""
    try:
        yield
    except DamageError as error:
        layout.damage = error.damage


def truncated(what: str) -> DamageError:
    """The file ends before `what`."""
    return DamageError(Failure("image_truncated", f"The file ends too early: {what}.", SEND_AGAIN))


def unreadable(what: str) -> DamageError:
    """The file's structure is broken, or has more parts than any camera writes."""
    return DamageError(Failure("image_unreadable", f"The file is damaged: {what}.", SEND_AGAIN))
