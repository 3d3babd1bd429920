"""What an XMP packet (ISO 16684-1) tells about a place, taken out at the same length. bytes -> bytes.

Properties are known by their local name, under any prefix: EXIF's GPS, the places of IPTC and Photoshop, the
photographer's address, and the coordinates of drones and depth formats. Attributes and whole elements become spaces,
which leaves the XML well formed. A packet that is not plain UTF-8 XML, or still tells coordinates then, is emptied.
Compass and camera pose (GPano) do not tell where; they stay, as do free texts and keywords.
"""

import re

EMPTY_PACKET = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"/>'
TURNED_PACKET = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/" '
    b'xmlns:tiff="http://ns.adobe.com/tiff/1.0/" tiff:Orientation="%d"/>'
)
ORIENTATION = re.compile(rb"tiff:Orientation(?:=\"|>)([1-8])")
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
PLACE_NAME = re.compile(
    rb"[Gg][Pp][Ss][\w-]*+"
    rb"|(?:[A-Z][a-z]+)?(?:Latitude|Longitude|Longtitude|Altitude)\w*"
    rb"|City|State|Country\w*|Location\w*|SubLocation|Sublocation|ProvinceState|WorldRegion|shotLocation|CiAdr\w+"
    rb"|coverage|lat|long|lat_long|alt"
)
PLACE_LEFT = re.compile(rb"latitude|longitude|longtitude|exif:gps", re.IGNORECASE)
TAG = re.compile(
    rb"<(/?)([A-Za-z_][\w.:-]*+)((?:\s++[A-Za-z_][\w.:-]*+\s*+=\s*+(?:\"[^\"<]*+\"|'[^'<]*+'))*+)\s*+(/?)>"
)
ATTRIBUTE = re.compile(rb"([A-Za-z_][\w.:-]*+)\s*+=\s*+(?:\"[^\"<]*+\"|'[^'<]*+')")
SKIPPED = {b"<!--": b"-->", b"<?": b"?>"}


def without_places(packet: bytes) -> bytes:
    """The packet, as long as before, without properties that tell a place."""
    text = packet.rstrip(b"\0")
    if not text.strip():
        return packet
    is_plain = b"\0" not in text and text.removeprefix(BYTE_ORDER_MARK).lstrip().startswith(b"<")
    cleaned = _cleaned(text) if is_plain else None
    if cleaned is None or PLACE_LEFT.search(cleaned):
        return emptied_packet(len(packet), read_orientation(packet))
    return cleaned.ljust(len(packet), b"\0")


def read_orientation(packet: bytes) -> int | None:
    """The orientation, which decoders take from here where EXIF tells none; None if it is absent."""
    match = ORIENTATION.search(packet)
    return int(match[1]) if match else None


def emptied_packet(length: int, orientation: int | None = None) -> bytes:
    """A packet of this length without properties but the orientation; only spaces if it does not fit."""
    packet = EMPTY_PACKET if orientation is None else TURNED_PACKET % orientation
    return packet.ljust(length) if len(packet) <= length else b" " * length


def _cleaned(text: bytes) -> bytes | None:
    """The text with spaces in place of places; None if it is not XML of the simple kind that XMP is."""
    tags = _tags(text)
    if tags is None:
        return None
    result = bytearray(text)
    start, depth = 0, 0  # of the element that is being taken out, and how deep in it we are
    for tag in tags:
        is_closing, name, attributes, is_alone = tag.groups()
        if depth == 0 and (is_closing or not _tells_place(name)):
            _blank_attributes(result, attributes, tag.start(3))
            continue
        if depth == 0:
            start = tag.start()
        depth += -1 if is_closing else 0 if is_alone else 1
        if depth == 0:
            result[start : tag.end()] = b" " * (tag.end() - start)
    return None if depth else bytes(result)


def _tags(text: bytes) -> list[re.Match[bytes]] | None:
    """All tags; None if a bracket begins none (nor comment, nor instruction): a document type, CDATA, damage."""
    tags: list[re.Match[bytes]] = []
    position = text.find(b"<")
    while position >= 0:
        closing_mark = next(
            (end for start, end in SKIPPED.items() if text.startswith(start, position)), None
        )
        if closing_mark is not None:
            end = text.find(closing_mark, position)
            if end < 0:
                return None
        else:
            tag = TAG.match(text, position)
            if tag is None:
                return None
            tags.append(tag)
            end = tag.end()
        position = text.find(b"<", end)
    return tags


def _blank_attributes(result: bytearray, attributes: bytes, at: int) -> None:
    for attribute in ATTRIBUTE.finditer(attributes):
        if _tells_place(attribute[1]):
            start = at + attribute.start()
            result[start : start + len(attribute[0])] = b" " * len(attribute[0])


def _tells_place(name: bytes) -> bool:
    prefix, _, local = name.rpartition(b":")
    return prefix != b"xmlns" and PLACE_NAME.fullmatch(local) is not None
