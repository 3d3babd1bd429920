"""What Photoshop's image resources, and the IPTC data in them (IIM 4.2), tell about a place, taken out. bytes -> bytes.

The resources are those of JPEG's APP13 after its `Photoshop 3.0` mark. What cannot be read to its end becomes zeros.
"""

from app.photos.gps import without_gps
from app.photos.xmp import without_places as xmp_without_places

IPTC, EXIF_1, EXIF_3, XMP = 0x0404, 0x0422, 0x0423, 0x0424
# Of record 2: content location code and name, city, sublocation, province, country code and name.
PLACE_DATASETS = frozenset({26, 27, 90, 92, 95, 100, 101})


def resources_without_places(block: bytes) -> bytes:
    """Image resources, as long as before, without places in their IPTC, EXIF and XMP."""
    result = bytearray(block)
    position = 0
    while any(block[position : position + 4]):  # else padding, or the end
        name_bytes = block[position + 6] if position + 6 < len(block) else 0
        size_at = position + 6 + (name_bytes + 2) // 2 * 2
        start = size_at + 4
        end = start + int.from_bytes(block[size_at:start])
        if block[position : position + 4] not in {
            b"8BIM",
            b"MeSa",
            b"AgHg",
            b"PHUT",
            b"DCSR",
        } or end > len(block):
            break
        kind = int.from_bytes(block[position + 4 : position + 6])
        content = block[start:end]
        if kind == IPTC:
            result[start:end] = iptc_without_places(content)
        elif kind in {EXIF_1, EXIF_3}:
            result[start:end] = without_gps(content)
        elif kind == XMP:
            result[start:end] = xmp_without_places(content)
        position = min(end + (end - start) % 2, len(block))
    return bytes(result[:position]) + bytes(len(block) - position)


def iptc_without_places(block: bytes) -> bytes:
    """IIM datasets, as long as before, with spaces for the values that tell a place."""
    result = bytearray(block)
    position = 0
    while any(block[position : position + 5]):
        start = position + 5
        length = int.from_bytes(block[position + 3 : start])
        if length & 0x8000:  # an extended dataset: the length of the length comes first
            length_bytes = length & 0x7FFF
            if length_bytes > 4:
                break
            start += length_bytes
            length = int.from_bytes(block[start - length_bytes : start])
        if block[position] != 0x1C or start + length > len(block):
            break
        if block[position + 1] == 2 and block[position + 2] in PLACE_DATASETS:
            result[start : start + length] = b" " * length
        position = start + length
    return bytes(result[:position]) + bytes(len(block) - position)
