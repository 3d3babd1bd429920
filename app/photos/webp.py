"""The layout of a WebP file (RFC 9649): its RIFF chunks and the size of its one picture. Animations are refused."""

from app.photos.byte_file import Data
from app.photos.layout import Layout, Part, damage_recorded, truncated, unreadable

HEADER_BYTES = 12  # RIFF, the size of what follows, WEBP
LOSSLESS_PICTURE = b"VP8L"
PICTURES = frozenset({b"VP8 ", LOSSLESS_PICTURE})
ANIMATION = frozenset({b"ANIM", b"ANMF"})
KEYFRAME_MARK = b"\x9d\x01\x2a"
LOSSLESS_MARK = b"\x2f"
SIDE_BITS = 0x3FFF


def is_webp(start: bytes) -> bool:
    """Whether a file that begins so is one."""
    return start.startswith(b"RIFF") and start[8:12] == b"WEBP"


def read_webp_layout(data: Data) -> Layout:
    """Walk the chunks to the end that the file's header gives. The file begins as is_webp asks."""
    layout = Layout(HEADER_BYTES)
    with damage_recorded(layout):
        _walk(data, layout)
    return layout


def _walk(data: Data, layout: Layout) -> None:
    end_of_file = 8 + int.from_bytes(data[4:8], "little")
    if end_of_file > len(data):
        raise truncated("the WebP is shorter than it says")
    while (start := layout.end + 8) <= end_of_file:
        kind, length = (
            data[start - 8 : start - 4],
            int.from_bytes(data[start - 4 : start], "little"),
        )
        end = start + length
        if end > end_of_file:
            raise truncated("a WebP chunk is cut")
        if kind in ANIMATION:
            raise unreadable("the WebP is an animation, not a photograph")
        if kind in PICTURES:
            if layout.width:
                raise unreadable("the WebP has more than one picture")
            size = (
                _lossy_size(data, start, end)
                if kind == b"VP8 "
                else _lossless_size(data, start, end)
            )
            if 0 in size:
                raise unreadable("the WebP's picture has no header")
            layout.width, layout.height = size
        layout.parts.append(Part(kind, start, end))
        layout.end = end + length % 2
    if layout.width == 0:
        raise unreadable("the WebP has no picture")


def _lossy_size(data: Data, start: int, end: int) -> tuple[int, int]:
    head = data[start : min(start + 10, end)]
    if len(head) < 10 or head[3:6] != KEYFRAME_MARK:
        return 0, 0
    return int.from_bytes(head[6:8], "little") & SIDE_BITS, int.from_bytes(
        head[8:10], "little"
    ) & SIDE_BITS


def _lossless_size(data: Data, start: int, end: int) -> tuple[int, int]:
    head = data[start : min(start + 5, end)]
    if len(head) < 5 or head[:1] != LOSSLESS_MARK:
        return 0, 0
    bits = int.from_bytes(head[1:5], "little")
    return (bits & SIDE_BITS) + 1, (bits >> 14 & SIDE_BITS) + 1
