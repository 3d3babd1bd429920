"""The TIFF structure of an EXIF block (CIPA DC-008): its directories, and the orientation among them. bytes -> values.

A block is bytes that begin with the TIFF header. Offsets are the block's own. A block whose directories cannot all be
read within bounds and limits has no directories: who reads on guesses, and who removes has to remove all.
"""

from dataclasses import dataclass
from typing import Literal

ByteOrder = Literal["little", "big"]

HEADERS: dict[bytes, ByteOrder] = {b"II*\0": "little", b"MM\0*": "big"}
ORIENTATION, EXIF_IFD, GPS_IFD, INTEROPERABILITY_IFD, SUB_IFDS = (
    0x0112,
    0x8769,
    0x8825,
    0xA005,
    0x014A,
)
VALUE_BYTES = {
    1: 1,
    2: 1,
    3: 2,
    4: 4,
    5: 8,
    6: 1,
    7: 1,
    8: 2,
    9: 4,
    10: 8,
    11: 4,
    12: 8,
    13: 4,
    129: 1,
}
ENTRY_BYTES = 12
XMP = 0x02BC
MAX_DIRECTORIES = 32
MAX_ENTRIES = 1024  # of all directories together; cameras write some 100


@dataclass(frozen=True, slots=True)
class Entry:
    """A directory's entry: tag, type, count, its 12 bytes' offset, and where its value is (unchecked)."""

    tag: int
    kind: int
    count: int
    at: int
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Directory:
    """A directory (IFD): its offset and entries; what its pointer was, GPS_IFD or another."""

    at: int
    tag: int
    entries: tuple[Entry, ...]


def byte_order(block: bytes) -> ByteOrder | None:
    """The block's byte order; None if it has no TIFF header."""
    return HEADERS.get(block[:4])


def read_directories(block: bytes) -> list[Directory] | None:
    """All directories that can be reached; None if one cannot be read whole or there are too many. A loop ends itself.

    A pointer to outside the block leads nowhere and is passed over.
    """
    order = byte_order(block)
    if order is None or len(block) < 8:
        return None
    found: list[Directory] = []
    # a directory that is reached both as GPS and as another counts as both
    visited: set[tuple[int, bool]] = set()
    entries_left = MAX_ENTRIES
    first = int.from_bytes(block[4:8], order)
    waiting = [(first, 0)]
    while waiting:
        at, tag = waiting.pop()
        if (at, tag == GPS_IFD) in visited or at < 8 or at + 2 > len(block):
            continue
        visited.add((at, tag == GPS_IFD))
        directory = _read_directory(block, at, tag, order, entries_left)
        if directory is None:
            return None
        entries_left -= len(directory.entries)
        found.append(directory)
        waiting.extend(_pointers(block, directory, order))
        if len(found) + len(waiting) > MAX_DIRECTORIES:
            return None
    return found


def read_orientation(block: bytes) -> int | None:
    """EXIF orientation, 1 to 8; 1 where it makes no sense, None where it is absent. Reads the first directory only."""
    order = byte_order(block)
    if order is None or len(block) < 8:
        return None
    first = int.from_bytes(block[4:8], order)
    count = int.from_bytes(block[first : first + 2], order)
    end = first + 2 + min(count, MAX_ENTRIES) * ENTRY_BYTES
    for at in range(first + 2, min(end, len(block) - ENTRY_BYTES + 1), ENTRY_BYTES):
        entry = _read_entry(block, at, order)
        if entry.tag == ORIENTATION and entry.count == 1:
            value = read_numbers(block, entry, order)
            return int(value[0]) if value and value[0] in range(1, 9) else 1
    return None


def read_numbers(block: bytes, entry: Entry, order: ByteOrder) -> list[float]:
    """The numbers of an entry of bytes, shorts, longs or rationals; empty if out of bounds, of another type, or n/0."""
    size = {1: 1, 3: 2, 4: 4, 5: 4, 13: 4}.get(entry.kind)
    if size is None or entry.end > len(block) or entry.count > MAX_ENTRIES:
        return []
    words = [
        int.from_bytes(block[at : at + size], order) for at in range(entry.start, entry.end, size)
    ]
    if entry.kind != 5:
        return [float(word) for word in words]
    pairs = list(zip(words[::2], words[1::2], strict=True))
    return [above / below for above, below in pairs] if all(below for _, below in pairs) else []


def minimal_block(length: int, orientation: int) -> bytes:
    """A block of this length that tells the orientation and nothing else; zeros if it does not fit."""
    block = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0" + bytes([orientation]) + bytes(7)
    return block.ljust(length, b"\0") if len(block) <= length else bytes(length)


def _read_directory(
    block: bytes, at: int, tag: int, order: ByteOrder, entries_left: int
) -> Directory | None:
    count = int.from_bytes(block[at : at + 2], order)
    if count > entries_left or at + 2 + count * ENTRY_BYTES > len(block):
        return None
    starts = range(at + 2, at + 2 + count * ENTRY_BYTES, ENTRY_BYTES)
    return Directory(at, tag, tuple(_read_entry(block, start, order) for start in starts))


def _read_entry(block: bytes, at: int, order: ByteOrder) -> Entry:
    tag, kind = (
        int.from_bytes(block[at : at + 2], order),
        int.from_bytes(block[at + 2 : at + 4], order),
    )
    count = int.from_bytes(block[at + 4 : at + 8], order)
    size = VALUE_BYTES.get(kind, 1) * count
    start = at + 8 if size <= 4 else int.from_bytes(block[at + 8 : at + 12], order)
    return Entry(tag, kind, count, at, start, start + size)


def _pointers(block: bytes, directory: Directory, order: ByteOrder) -> list[tuple[int, int]]:
    """Where the directory leads: to sub-directories, and on to the next of its chain."""
    found: list[tuple[int, int]] = []
    for entry in directory.entries:
        if entry.tag in {EXIF_IFD, GPS_IFD, INTEROPERABILITY_IFD, SUB_IFDS}:
            size = 2 if entry.kind == 3 else 4
            end = min(entry.end, len(block), entry.start + size * (MAX_DIRECTORIES + 1))
            starts = range(entry.start, end - size + 1, size)
            found.extend((int.from_bytes(block[at : at + size], order), entry.tag) for at in starts)
    after = directory.at + 2 + len(directory.entries) * ENTRY_BYTES
    if directory.tag in {0, SUB_IFDS} and after + 4 <= len(block):
        found.append((int.from_bytes(block[after : after + 4], order), directory.tag))
    return found
