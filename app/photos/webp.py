"""The layout of a WebP file (RFC 9649): its RIFF chunks and the size of its one picture. Animations are refused."""

from app.core.errors import Failure
from app.photos.byte_file import Data
from app.photos.chunks import Chunk, ChunkLayout
from app.photos.damage import truncated, unreadable

HEADER_BYTES = 12  # RIFF, the size of what follows, WEBP
MAX_CHUNKS = 1000  # a photograph has five at most; an animation's frames are chunks, too
PICTURES = frozenset({b"VP8 ", b"VP8L"})
ANIMATION = frozenset({b"ANIM", b"ANMF"})
KEYFRAME_MARK = b"\x9d\x01\x2a"
LOSSLESS_MARK = b"\x2f"
SIDE_BITS = 0x3FFF


def is_webp(start: bytes) -> bool:
    """Whether a file that begins so is one."""
    return start.startswith(b"RIFF") and start[8:12] == b"WEBP"


def read_webp_layout(data: Data) -> ChunkLayout:
    """Walk the chunks to the end that the file's header gives. The file begins as is_webp asks."""
    chunks: list[Chunk] = []
    size = (0, 0)
    position = HEADER_BYTES
    end_of_file = 8 + int.from_bytes(data[4:8], "little")

    def layout(damage: Failure | None) -> ChunkLayout:
        return ChunkLayout(tuple(chunks), *size, position, damage)

    if end_of_file > len(data):
        return layout(truncated("the WebP is shorter than it says"))
    while position + 8 <= end_of_file:
        if len(chunks) >= MAX_CHUNKS:
            return layout(unreadable(f"the WebP has more than {MAX_CHUNKS} chunks"))
        kind, length = data[position : position + 4], int.from_bytes(data[position + 4 : position + 8], "little")
        start, end = position + 8, position + 8 + length
        if end > end_of_file:
            return layout(truncated("a WebP chunk is cut"))
        if kind in ANIMATION:
            return layout(unreadable("the WebP is an animation, not a photograph"))
        if kind in PICTURES:
            if 0 not in size:
                return layout(unreadable("the WebP has more than one picture"))
            size = _lossy_size(data, start, end) if kind == b"VP8 " else _lossless_size(data, start, end)
            if 0 in size:
                return layout(unreadable("the WebP's picture has no header"))
        chunks.append(Chunk(kind, start, end))
        position = end + length % 2
    return layout(unreadable("the WebP has no picture") if 0 in size else None)


def _lossy_size(data: Data, start: int, end: int) -> tuple[int, int]:
    head = data[start : min(start + 10, end)]
    if len(head) < 10 or head[3:6] != KEYFRAME_MARK:
        return 0, 0
    return int.from_bytes(head[6:8], "little") & SIDE_BITS, int.from_bytes(head[8:10], "little") & SIDE_BITS


def _lossless_size(data: Data, start: int, end: int) -> tuple[int, int]:
    head = data[start : min(start + 5, end)]
    if len(head) < 5 or head[:1] != LOSSLESS_MARK:
        return 0, 0
    bits = int.from_bytes(head[1:5], "little")
    return (bits & SIDE_BITS) + 1, (bits >> 14 & SIDE_BITS) + 1
