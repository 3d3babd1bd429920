"""The location in an EXIF block: read it, or take it out of the bytes at the same length.

Taking out: the GPS directory's entries and their values become zeros, and the pointer to it is taken out of its
directory, whose other entries close up; no offset changes, so all other tags stay as they were. A block that cannot be
read whole is reduced to its orientation. A maker's note is opaque and stays (Apple's holds no location).
"""

from dataclasses import dataclass

from app.photos.byte_file import Extent, merged
from app.photos.tiff import (
    ENTRY_BYTES,
    GPS_IFD,
    VALUE_BYTES,
    ByteOrder,
    Directory,
    Entry,
    byte_order,
    minimal_block,
    read_directories,
    read_numbers,
    read_orientation,
)

LATITUDE, LONGITUDE, STATUS = 2, 4, 9  # the hemisphere of each stands in the tag before it


@dataclass(frozen=True, slots=True)
class Location:
    """Where a photograph was taken: WGS84, degrees, north and east positive."""

    latitude_deg: float
    longitude_deg: float


def read_gps(block: bytes) -> Location | None:
    """The location in an EXIF block; None if absent, void, out of range, or the zeros of a receiver without a fix."""
    order = byte_order(block)
    directory = next((one for one in read_directories(block) or [] if one.tag == GPS_IFD), None)
    if order is None or directory is None:
        return None
    entries = {entry.tag: entry for entry in directory.entries}
    latitude = _degrees(block, entries, LATITUDE, (b"N", b"S"), order)
    longitude = _degrees(block, entries, LONGITUDE, (b"E", b"W"), order)
    if latitude is None or longitude is None or _letter(block, entries.get(STATUS)) == b"V":
        return None
    if abs(latitude) > 90 or abs(longitude) > 180 or latitude == longitude == 0:
        return None
    return Location(latitude, longitude)


def without_gps(block: bytes) -> bytes:
    """The block, as long as before, without any location tag."""
    order = byte_order(block)
    if not any(block):
        return block
    directories = read_directories(block)
    if order is None or not directories:
        return _reduced(block)
    result = bytearray(block)
    gps_directories = [directory for directory in directories if directory.tag == GPS_IFD]
    if not all(_has_known_places(directory, len(block)) for directory in gps_directories):
        return _reduced(block)
    for start, end in merged(
        extent for directory in gps_directories for extent in _extents(directory)
    ):
        result[start:end] = bytes(end - start)
    for directory in directories:
        if directory.tag != GPS_IFD:
            _drop_gps_pointers(result, directory, order)
    cleaned = bytes(result)
    left = read_directories(cleaned)  # directories that overlapped may have become anything
    return _reduced(block) if left is None or any(one.tag == GPS_IFD for one in left) else cleaned


def _reduced(block: bytes) -> bytes:
    return minimal_block(len(block), read_orientation(block) or 1)


def _has_known_places(directory: Directory, length: int) -> bool:
    """Whether each value has a known size and lies within the block's length."""
    return all(
        entry.end <= length and (entry.kind in VALUE_BYTES or entry.kind == entry.count == 0)
        for entry in directory.entries
    )


def _extents(directory: Directory) -> list[Extent]:
    """Those of the directory and of its values, which may overlap."""
    own = (directory.at, directory.at + 2 + len(directory.entries) * ENTRY_BYTES)
    return [own, *((entry.start, entry.end) for entry in directory.entries)]


def _drop_gps_pointers(block: bytearray, directory: Directory, order: ByteOrder) -> None:
    """Close the directory up over its GPS pointers; the pointer to the next directory moves with the entries."""
    kept = [entry for entry in directory.entries if entry.tag != GPS_IFD]
    dropped = len(directory.entries) - len(kept)
    if dropped == 0:
        return
    end = directory.at + 2 + len(directory.entries) * ENTRY_BYTES
    after = bytes(block[end : end + 4])
    content = b"".join(bytes(block[entry.at : entry.at + ENTRY_BYTES]) for entry in kept) + after
    block[directory.at : end + len(after)] = (
        len(kept).to_bytes(2, order) + content + bytes(dropped * ENTRY_BYTES)
    )


def _degrees(
    block: bytes,
    entries: dict[int, Entry],
    tag: int,
    positive_negative: tuple[bytes, bytes],
    order: ByteOrder,
) -> float | None:
    """Degrees, minutes and seconds with their hemisphere as signed degrees; None where one of them is missing."""
    entry, reference = entries.get(tag), _letter(block, entries.get(tag - 1))
    parts = read_numbers(block, entry, order) if entry else []
    if len(parts) != 3 or reference not in positive_negative:
        return None
    degrees = parts[0] + parts[1] / 60 + parts[2] / 3600
    return degrees if reference == positive_negative[0] else -degrees


def _letter(block: bytes, entry: Entry | None) -> bytes:
    return (
        block[entry.start : entry.start + 1].upper() if entry and entry.end <= len(block) else b""
    )
