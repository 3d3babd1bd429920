"""Where metadata stand in JPEG, PNG, WebP and HEIC: layout -> the extents of each block of EXIF, XMP or Photoshop."""

from collections import defaultdict
from collections.abc import Iterable, Sequence

from app.photos.byte_file import Data, Extent
from app.photos.heif import HeifItem
from app.photos.jpeg import APP1, APP13
from app.photos.layout import Part
from app.photos.tiff import HEADERS

PNG_EXIF, WEBP_EXIF = b"eXIf", b"EXIF"  # kinds of chunks
EXIF_MARK = b"Exif\0"  # and one more byte: 0, or FF by some writers
XMP_MARK = b"http://ns.adobe.com/xap/1.0/\0"
EXTENDED_XMP_MARK = b"http://ns.adobe.com/xmp/extension/\0"
# the mark, a digest, the whole's length, the offset in it
EXTENDED_XMP_HEADER_BYTES = len(EXTENDED_XMP_MARK) + 32 + 4 + 4
PNG_XMP_MARK = b"XML:com.adobe.xmp\0\0"  # keyword and the flag of no compression; then method, language, keyword, text
PHOTOSHOP_MARK = b"Photoshop 3.0\0"
MAX_TIFF_HEADER_OFFSET = 64  # in HEIC: past "Exif\0\0" at most, says every writer


def jpeg_exif_blocks(data: Data, segments: Iterable[Part]) -> list[list[Extent]]:
    """EXIF blocks. Decoders join several segments, so the first block is all of them; then each that stands alone."""
    single = [
        (segment.start + 6, segment.end)
        for segment in segments
        if segment.kind == APP1
        and _begins(data, segment, EXIF_MARK)
        and segment.end - segment.start >= 6
    ]
    if len(single) <= 1:
        return [single] if single else []
    return [single, *([one] for one in single[1:] if data[one[0] : one[0] + 4] in HEADERS)]


def jpeg_xmp_packets(
    data: Data, segments: Iterable[Part]
) -> tuple[list[list[Extent]], list[list[Extent]]]:
    """XMP packets: each main one, and each extended one put together in order; and parts that do not make a whole."""
    packets: list[list[Extent]] = []
    # by the extended packet's digest and length
    parts: dict[bytes, list[tuple[int, Extent]]] = defaultdict(list)
    for segment in segments:
        if segment.kind != APP1:
            continue
        if _begins(data, segment, XMP_MARK):
            packets.append([(segment.start + len(XMP_MARK), segment.end)])
        elif _begins(data, segment, EXTENDED_XMP_MARK):
            start = segment.start + EXTENDED_XMP_HEADER_BYTES
            if start < segment.end:
                offset = int.from_bytes(data[start - 4 : start])
                parts[data[start - 40 : start - 4]].append((offset, (start, segment.end)))
    fragments: list[list[Extent]] = []
    for key, found in parts.items():
        found.sort()
        ends = [offset + end - start for offset, (start, end) in found]
        is_whole = [offset for offset, _ in found] == [0, *ends[:-1]] and ends[
            -1
        ] == int.from_bytes(key[-4:])
        (packets if is_whole else fragments).append([extent for _, extent in found])
    return packets, fragments


def jpeg_photoshop_blocks(data: Data, segments: Iterable[Part]) -> list[list[Extent]]:
    """Photoshop's image resources: those of all segments joined, as they may run on from one to the next."""
    extents = [
        (segment.start + len(PHOTOSHOP_MARK), segment.end)
        for segment in segments
        if segment.kind == APP13 and _begins(data, segment, PHOTOSHOP_MARK)
    ]
    return [extents] if extents else []


def chunk_exif_blocks(data: Data, chunks: Iterable[Part], kind: bytes) -> list[list[Extent]]:
    """EXIF blocks of a PNG's or WebP's chunks of this kind; some writers put JPEG's mark before them."""
    return [
        [
            (
                chunk.start + 6
                if data[chunk.start : chunk.start + 5] == EXIF_MARK
                else chunk.start,
                chunk.end,
            )
        ]
        for chunk in chunks
        if chunk.kind == kind
    ]


def png_xmp_packets(data: Data, chunks: Iterable[Part]) -> list[list[Extent]]:
    """XMP packets of iTXt chunks that are not compressed."""
    packets: list[list[Extent]] = []
    for chunk in chunks:
        if (
            chunk.kind == b"iTXt"
            and data[chunk.start : chunk.start + len(PNG_XMP_MARK)] == PNG_XMP_MARK
        ):
            language_end = data.find(b"\0", chunk.start + len(PNG_XMP_MARK) + 1, chunk.end)
            translated_end = (
                data.find(b"\0", language_end + 1, chunk.end) if language_end >= 0 else -1
            )
            if translated_end >= 0:
                packets.append([(translated_end + 1, chunk.end)])
    return packets


def webp_xmp_packets(chunks: Iterable[Part]) -> list[list[Extent]]:
    """XMP packets."""
    return [[(chunk.start, chunk.end)] for chunk in chunks if chunk.kind == b"XMP "]


def heif_exif_blocks(data: Data, items: Iterable[HeifItem]) -> list[list[Extent]]:
    """EXIF blocks of Exif items, from the TIFF header on; the whole item where no header is found."""
    return [_from_tiff_header(data, item.extents) for item in items if item.kind == b"Exif"]


def heif_xmp_packets(items: Iterable[HeifItem]) -> list[list[Extent]]:
    """XMP packets of mime items."""
    return [list(item.extents) for item in items if item.is_xmp]


def _from_tiff_header(data: Data, extents: Sequence[Extent]) -> list[Extent]:
    start = b"".join(
        data[first : min(last, first + 8 + MAX_TIFF_HEADER_OFFSET)] for first, last in extents[:4]
    )
    offset = 4 + int.from_bytes(start[:4])
    if start[offset : offset + 4] not in HEADERS:
        offset = next((start.find(header) for header in HEADERS if header in start), 0)
    left = []
    for first, last in extents:
        skipped = min(offset, last - first)
        offset -= skipped
        left.append((first + skipped, last))
    return left


def _begins(data: Data, segment: Part, mark: bytes) -> bool:
    return data[segment.start : min(segment.start + len(mark), segment.end)] == mark
