"""What an uploaded file is (JPEG, PNG, WebP, HEIC), its size, how it is turned, whether it is whole. path -> facts.

Only structure is read. Whether the pixels decode shows later, in a child process; limits on the size are the caller's.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app.core.errors import Failure
from app.photos.byte_file import Data, Extent, read_extents
from app.photos.heif import HeifLayout, read_heif_layout
from app.photos.jpeg import read_jpeg_layout
from app.photos.layout import Layout
from app.photos.metadata import (
    PNG_EXIF,
    WEBP_EXIF,
    chunk_exif_blocks,
    heif_exif_blocks,
    jpeg_exif_blocks,
    jpeg_xmp_packets,
    png_xmp_packets,
    webp_xmp_packets,
)
from app.photos.png import SIGNATURE as PNG_SIGNATURE
from app.photos.png import read_png_layout
from app.photos.tiff import read_orientation
from app.photos.webp import is_webp, read_webp_layout
from app.photos.xmp import read_orientation as read_xmp_orientation

JPEG, PNG, HEIC, WEBP = "image/jpeg", "image/png", "image/heic", "image/webp"
READERS: dict[str, Callable[[Data], Layout]] = {
    JPEG: read_jpeg_layout,
    PNG: read_png_layout,
    HEIC: read_heif_layout,
    WEBP: read_webp_layout,
}
HEIF_BRANDS = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"})
# more than a baseline JPEG of 108 megapixels, or a progressive one of 12
COSTLY_PIXELS = 200_000_000
HEIC_PASSES = 6  # decoding a pixel of HEVC takes as long as that of 6 pixels of a baseline JPEG
ADVICE = "Send a JPEG, PNG, WebP or HEIC file."

# What else people send, by its first bytes.
OTHER_KINDS = (
    (b"%PDF", "a PDF document"),
    (b"GIF8", "a GIF picture"),
    (b"BM", "a BMP picture"),
    (b"II*\0", "a TIFF or raw picture"),
    (b"MM\0*", "a TIFF or raw picture"),
    (b"8BPS", "a Photoshop picture"),
    (b"\xff\x0a", "a JPEG XL picture"),
    (b"\0\0\0\x0cJXL ", "a JPEG XL picture"),
    (b"\0\0\0\x0cjP  ", "a JPEG 2000 picture"),
    (b"\x1a\x45\xdf\xa3", "a video"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"<", "a web page or XML text"),
    (b"{", "JSON text"),
)


@dataclass(frozen=True, slots=True)
class PhotoFacts:
    """A whole photograph. width and height are as stored, before orientation (EXIF's values, 1 to 8) turns them.

    In HEIC they are cropped as a decoder crops them; pixels_to_decode counts what it makes before that, and is what a
    limit on memory should look at. scans: of a JPEG, each a pass over all pixels.
    """

    media_type: str
    width: int
    height: int
    orientation: int
    pixels_to_decode: int
    scans: int = 1

    @property
    def decoding_pixels(self) -> int:
        """Return how many pixels of a baseline JPEG take as long to decode."""
        return self.pixels_to_decode * (HEIC_PASSES if self.media_type == HEIC else self.scans)


def inspect_photo(path: Path) -> PhotoFacts | Failure:
    """The facts of the file at `path`.

    Failures: not_an_image, image_truncated, image_unreadable. Raises OSError if the file cannot be read.
    """
    data = path.read_bytes()
    media_type = sniff(data)
    if isinstance(media_type, Failure):
        return media_type
    layout = READERS[media_type](data)
    if layout.damage is not None:
        return layout.damage
    if isinstance(layout, HeifLayout):
        orientation, pixels = layout.orientation, layout.pixels_to_decode
    else:
        orientation, pixels = _orientation(data, media_type, layout), layout.width * layout.height
    return PhotoFacts(media_type, layout.width, layout.height, orientation, pixels, layout.scans)


def exif_blocks(data: Data, media_type: str, layout: Layout) -> list[list[Extent]]:
    """The extents of each block of EXIF."""
    if isinstance(layout, HeifLayout):
        return heif_exif_blocks(data, layout.items)
    if media_type == JPEG:
        return jpeg_exif_blocks(data, layout.parts)
    return chunk_exif_blocks(data, layout.parts, PNG_EXIF if media_type == PNG else WEBP_EXIF)


def sniff(data: Data) -> str | Failure:
    """The media type by the first bytes, or what the file looks like instead."""
    start = data[:16]
    if start.startswith(b"\xff\xd8\xff"):
        return JPEG
    if start.startswith(PNG_SIGNATURE):
        return PNG
    if start[4:8] == b"ftyp" and start[8:12] in HEIF_BRANDS:
        return HEIC
    if is_webp(start):
        return WEBP
    what = _other_kind(start)
    message = (
        f"The file looks like {what}, not like a photograph."
        if what
        else "The file is no photograph."
    )
    return Failure("not_an_image", message, ADVICE)


def _orientation(data: Data, media_type: str, layout: Layout) -> int:
    """That of the first EXIF block, or else of the first XMP packet, as decoders read it."""
    blocks = exif_blocks(data, media_type, layout)
    orientation = read_orientation(read_extents(data, blocks[0])) if blocks else None
    if orientation is None:
        if media_type == JPEG:
            packets, _ = jpeg_xmp_packets(data, layout.parts)
        else:
            packets = (
                png_xmp_packets(data, layout.parts)
                if media_type == PNG
                else webp_xmp_packets(layout.parts)
            )
        orientation = read_xmp_orientation(read_extents(data, packets[0])) if packets else None
    return 1 if orientation is None else orientation


def _other_kind(start: bytes) -> str | None:
    if start[4:8] == b"ftyp":
        return "an AVIF picture" if start[8:12] in {b"avif", b"avis"} else "a video"
    if start.startswith(b"RIFF"):
        return "a video or sound"
    return next((what for magic, what in OTHER_KINDS if start.startswith(magic)), None)
