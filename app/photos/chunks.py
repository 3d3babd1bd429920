"""What the readers of PNG and WebP return: both files are a row of chunks."""

from dataclasses import dataclass

from app.core.errors import Failure


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk's type, and where its data starts and ends: without length, type, checksum and padding."""

    kind: bytes
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class ChunkLayout:
    """What was read, up to the end or the damage; `end` is the first byte that was not read."""

    chunks: tuple[Chunk, ...]
    width: int
    height: int
    end: int
    damage: Failure | None
