"""A file's bytes under edit at the same length.

Edits are made in a private mapping, so that later steps see what earlier ones did and only touched pages cost memory.
Then they are written with ordinary writes: these report a full disk as an error, where a shared mapping kills.
"""

import mmap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

Data = bytes | mmap.mmap
Extent = tuple[int, int]  # start and end of a run of bytes in the file, the end not included

MAX_MARKED_BLOCKS = 128  # which may overlap; a burst or a gain map has a few dozen


class Edits:
    """Bytes under edit: what was changed, and where. The length never changes."""

    def __init__(self, data: mmap.mmap) -> None:
        self.data = data
        self.marked_blocks_left = MAX_MARKED_BLOCKS
        self.changed: list[Extent] = []

    def read(self, extents: Sequence[Extent]) -> bytes:
        """The bytes of the extents, joined."""
        return read_extents(self.data, extents)

    def write(self, extents: Sequence[Extent], replacement: bytes) -> None:
        """Put `replacement`, as long as the extents together, in their place; equal bytes are no change."""
        if length_of(extents) != len(replacement):
            raise ValueError("a replacement must have the length of what it replaces")
        position = 0
        for start, end in extents:
            piece = replacement[position : position + end - start]
            position += end - start
            if self.data[start:end] != piece:
                self.data[start:end] = piece
                self.changed.append((start, end))

    def may_clean_marked_block(self) -> bool:
        """Whether one more block may be taken apart; past the limit it goes whole, so that many cannot take long."""
        self.marked_blocks_left -= 1
        return self.marked_blocks_left >= 0

    def blank(self, start: int, end: int) -> None:
        """Zeros from start to end."""
        self.write([(start, end)], bytes(end - start))


def read_extents(data: Data, extents: Sequence[Extent]) -> bytes:
    """The bytes of the extents, joined."""
    return b"".join(data[start:end] for start, end in extents)


def merged(extents: Iterable[Extent]) -> list[Extent]:
    """The same bytes in ascending extents that do not overlap."""
    result: list[Extent] = []
    for start, end in sorted(extents):
        if result and start <= result[-1][1]:
            result[-1] = (result[-1][0], max(end, result[-1][1]))
        else:
            result.append((start, end))
    return result


def length_of(extents: Sequence[Extent]) -> int:
    """How many bytes the extents have together."""
    return sum(end - start for start, end in extents)


@contextmanager
def edit_bytes(path: Path) -> Iterator[Edits]:
    """The bytes of a file that is not empty; the edits are written to it when the block ends well."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY) as data:
        edits = Edits(data)
        yield edits
        for start, end in edits.changed:
            file.seek(start)
            file.write(data[start:end])
