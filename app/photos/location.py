"""Take the location out of a photograph's file, in place and at the same length, or read it. path -> changed or not.

What goes: EXIF's GPS directory (of the main picture, previews and secondary pictures), places and coordinates in XMP
and IPTC, PNG's compressed metadata whole, location atoms of an attached video, and blocks of unknown form that speak of
coordinates. Pixels, and all that tells of lens, time and orientation, stay byte for byte. What stays: free texts and
keywords, makers' notes, a video's timed tracks. The file is inspected first; of a damaged one, what can be reached is
cleaned and the rest is treated as a part of unknown form.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from app.photos.byte_file import Data, Edits, Extent, edit_bytes, length_of, merged, read_extents
from app.photos.depth import TIFF
from app.photos.embedded import clean_embedded, clean_opaque, clean_samsung_trailer
from app.photos.gps import Location, read_gps, without_gps
from app.photos.heif import HeifLayout
from app.photos.inspect import JPEG, PNG, READERS, PhotoFacts, exif_blocks
from app.photos.iptc import resources_without_places
from app.photos.jpeg import APP0, APP1, APP2, APP13, APP14, APP15, COM
from app.photos.layout import Part
from app.photos.metadata import (
    PNG_EXIF,
    chunk_exif_blocks,
    heif_xmp_packets,
    jpeg_photoshop_blocks,
    jpeg_xmp_packets,
    webp_xmp_packets,
)
from app.photos.png import renew_checksum, text_without_places
from app.photos.tiff import XMP, read_directories
from app.photos.xmp import emptied_packet, without_places

# ICC profiles and MPF's index are binary and tell no place; a chance match in them would cost colours.
PLAIN_PNG_CHUNKS = frozenset(
    {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"iCCP", b"eXIf", b"tRNS", b"fdAT"}
)
PLAIN_WEBP_CHUNKS = frozenset({b"VP8X", b"VP8 ", b"VP8L", b"ALPH", b"ICCP", b"EXIF", b"XMP "})
PLAIN_HEIF_BOXES = frozenset({b"ftyp", b"meta", b"mdat"})


def remove_location(path: Path, facts: PhotoFacts) -> bool:
    """Remove the location from the file at `path`, whose `facts` inspect_photo told; whether anything was there.

    Raises OSError if the file cannot be read or written.
    """
    if path.stat().st_size == 0:
        return False
    with edit_bytes(path) as edits:
        data = edits.data
        if facts.media_type == TIFF:
            _clean_tiff(edits)
            return bool(edits.changed)
        layout = READERS[facts.media_type](data)
        if facts.media_type != PNG:
            _clean_exif(edits, exif_blocks(data, facts.media_type, layout))
        if isinstance(layout, HeifLayout):
            _clean_heif(edits, layout)
        elif facts.media_type == JPEG:
            _clean_jpeg(edits, layout.parts)
        elif facts.media_type == PNG:
            _clean_png(edits, layout.parts)
        else:
            _clean_webp(edits, layout.parts)
        clean_samsung_trailer(edits, layout.end, len(data))
        clean_embedded(edits, layout.end, len(data))
        return bool(edits.changed)


def read_location(path: Path, facts: PhotoFacts) -> Location | None:
    """The location in the EXIF of the file's main picture; None if there is none. XMP's is not read."""
    data = path.read_bytes()
    blocks = exif_blocks(data, facts.media_type, READERS[facts.media_type](data))
    return next(filter(None, (read_gps(read_extents(data, block)) for block in blocks)), None)


def _clean_exif(edits: Edits, blocks: Iterable[list[Extent]]) -> None:
    for block in blocks:
        edits.write(block, without_gps(edits.read(block)))
        for start, end in block:
            clean_embedded(edits, start, end)  # a preview's own metadata


def _clean_tiff(edits: Edits) -> None:
    """A depth map's file is one block of the kind that EXIF has; XMP stands in an entry of it."""
    whole = (0, len(edits.data))
    block = edits.read([whole])
    packets = [
        (entry.start, entry.end)
        for directory in read_directories(block) or []
        for entry in directory.entries
        if entry.tag == XMP and entry.end <= len(block)
    ]
    _clean_xmp(edits, [[packet] for packet in merged(packets)])
    _clean_exif(edits, [[whole]])


def _clean_xmp(edits: Edits, packets: Iterable[list[Extent]]) -> None:
    for packet in packets:
        edits.write(packet, without_places(edits.read(packet)))


def _clean_jpeg(edits: Edits, segments: Sequence[Part]) -> None:
    data = edits.data
    packets, fragments = jpeg_xmp_packets(data, segments)
    _clean_xmp(edits, packets)
    for fragment in fragments:
        edits.write(fragment, emptied_packet(length_of(fragment)))
    for block in jpeg_photoshop_blocks(data, segments):
        edits.write(block, resources_without_places(edits.read(block)))
    for segment in segments:
        if _is_opaque(data, segment):
            clean_opaque(edits, segment.start, segment.end)


def _is_opaque(data: Data, segment: Part) -> bool:
    """Whether the segment is an application's or a comment, and none whose form is known here."""
    if segment.kind in {APP0, APP2, APP14}:  # JFIF, ICC and MPF, Adobe
        return False
    if segment.kind in {APP1, APP13}:
        known = (b"Exif\0", b"http://ns.adobe.com/", b"Photoshop 3.0\0")
        return not data[segment.start : segment.start + 20].startswith(known)
    return APP0 < segment.kind <= APP15 or segment.kind == COM


def _clean_png(edits: Edits, chunks: Sequence[Part]) -> None:
    for chunk in chunks:
        changes = len(edits.changed)
        _clean_png_chunk(edits, chunk)
        if len(edits.changed) > changes:
            renew_checksum(edits, chunk)


def _clean_png_chunk(edits: Edits, chunk: Part) -> None:
    if chunk.kind == PNG_EXIF:
        _clean_exif(edits, chunk_exif_blocks(edits.data, [chunk], PNG_EXIF))
    elif chunk.kind in {b"tEXt", b"zTXt", b"iTXt"}:
        extent = (chunk.start - 4, chunk.end)
        edits.write([extent], text_without_places(edits.read([extent])))
    elif chunk.kind not in PLAIN_PNG_CHUNKS:
        clean_opaque(edits, chunk.start, chunk.end)


def _clean_webp(edits: Edits, chunks: Sequence[Part]) -> None:
    _clean_xmp(edits, webp_xmp_packets(chunks))
    for chunk in chunks:
        if chunk.kind not in PLAIN_WEBP_CHUNKS:
            clean_opaque(edits, chunk.start, chunk.end)


def _clean_heif(edits: Edits, layout: HeifLayout) -> None:
    _clean_xmp(edits, heif_xmp_packets(layout.items))
    for item in layout.items:
        if item.kind in {b"mime", b"uri "} and not item.is_xmp:
            for start, end in item.extents:
                clean_opaque(edits, start, end)
    for box in layout.parts:
        if box.kind == b"uuid":  # content credentials among others
            clean_opaque(edits, box.start, box.end)
        elif box.kind not in PLAIN_HEIF_BOXES:
            clean_embedded(edits, box.start, box.end)
            clean_samsung_trailer(edits, box.start, box.end)
