"""Recognise an uploaded voice note: WebM or MP4 with sound and no picture, as browsers record it. path -> media type.

Only the structure is read, by the file's own tables of tracks: nothing is decoded here or anywhere else in the server.
Under a policy that removes locations, a note's metadata are overwritten in place.
"""

from collections.abc import Iterator
from pathlib import Path

from app.core.errors import Failure
from app.photos.byte_file import Data, Edits, edit_bytes
from app.photos.embedded import clean_embedded

WEBM, MP4 = "audio/webm", "audio/mp4"
# two minutes at 128 kbit/s, the most that browsers choose by themselves
MAX_NOTE_BYTES = 2 * 1024**2
EBML, DOC_TYPE, SEGMENT, TRACKS, TRACK, TRACK_TYPE = (
    0x1A45DFA3,
    0x4282,
    0x18538067,
    0x1654AE6B,
    0xAE,
    0x83,
)
CLUSTER, TAGS, ATTACHMENTS, VOID = 0x1F43B675, 0x1254C367, 0x1941A469, 0xEC
WEBM_METADATA = frozenset({TAGS, ATTACHMENTS})
AUDIO_TRACK = 2  # Matroska's TrackType; 1: video
PATH = (b"moov", b"trak", b"mdia", b"hdlr")  # of MP4, down to the handler of a track
MP4_METADATA = frozenset({b"udta", b"meta", b"uuid"})
ADVICE = "Send WebM with Opus or MP4 with AAC, as a browser's MediaRecorder writes them, without a picture."

Part = tuple[int, int, int]  # an element's id, start and end of its content


def inspect_voice_note(path: Path) -> str | Failure:
    """Return the note's media type. Failure: voice_note_unreadable. Raises OSError if the file cannot be read."""
    data = path.read_bytes()
    try:
        if data[:4] == EBML.to_bytes(4):
            media_type, tracks = WEBM, list(_webm_tracks(data))
        else:
            media_type, tracks = (
                MP4,
                list(_mp4_tracks(data, 0, len(data))) if data[4:8] == b"ftyp" else [],
            )
    except (ValueError, IndexError):
        tracks = []
    if tracks and all(tracks):
        return media_type
    return _unreadable()


def remove_note_metadata(path: Path, media_type: str) -> bool | Failure:
    """Overwrite the metadata of an inspected note, in which a location may stand. Returns True if there was any.

    Failure: voice_note_unreadable, and nothing is written. Raises OSError if the file cannot be read or written.
    """
    try:
        with edit_bytes(path) as edits:
            if media_type == WEBM:
                _void_metadata(edits)
            else:
                _free_metadata(edits, 0, len(edits.data))
                clean_embedded(edits, 0, len(edits.data))  # location atoms elsewhere
    except (ValueError, IndexError):
        return _unreadable()
    return bool(edits.changed)


def _unreadable() -> Failure:
    return Failure(
        "voice_note_unreadable",
        "The file is no recording of sound alone, or it is damaged.",
        ADVICE,
    )


def _webm_tracks(data: Data) -> Iterator[bool]:
    """Yield for each track True if it is sound. Raises ValueError for another structure."""
    header, *others = _elements(data, 0, len(data), stop=SEGMENT)
    kinds = [
        bytes(data[start:end]).rstrip(b"\0")
        for name, start, end in _elements(data, *header[1:])
        if name == DOC_TYPE
    ]
    if kinds != [b"webm"] or not others or others[-1][0] != SEGMENT:
        raise ValueError("no WebM")
    *_, (name, start, end) = _elements(data, *others[-1][1:], stop=TRACKS)
    if name != TRACKS:
        raise ValueError("no tracks")
    for name, begin, stop in _elements(data, start, end):
        if name == TRACK:
            fields = _elements(data, begin, stop)
            yield [int.from_bytes(data[a:b]) for field, a, b in fields if field == TRACK_TYPE] == [
                AUDIO_TRACK
            ]


def _elements(data: Data, start: int, end: int, stop: int | None = None) -> Iterator[Part]:
    """Yield the EBML elements from start to end, or up to the first one with the id `stop` (RFC 8794)."""
    position = start
    while position < end:
        name, position = _number(data, position, keeps_marker=True)
        size, position = _number(data, position)
        # a recorder does not know its segment's length beforehand
        close = end if size is None else position + size
        if name is None or close > end:
            raise ValueError("an element is cut")
        yield name, position, close
        if name == stop:
            return
        position = close


def _number(data: Data, position: int, *, keeps_marker: bool = False) -> tuple[int | None, int]:
    """Return a number of variable length, None if it is the unknown one, and where it ends."""
    length = 9 - data[position].bit_length()
    if length > 8:
        raise ValueError("no such number")
    end = position + length
    value = int.from_bytes(data[position:end])
    if keeps_marker:
        return value, end
    value &= (1 << 7 * length) - 1
    return (None if value == (1 << 7 * length) - 1 else value), end


def _void_metadata(edits: Edits) -> None:
    """Make each metadata element a Void of the same length; segments and clusters of unknown length are entered."""
    data, position = edits.data, 0
    while position < len(data):
        name, at = _number(data, position, keeps_marker=True)
        size, content = _number(data, at)
        end = content if size is None or name == SEGMENT else content + size
        if end > len(data) or (size is None and name not in {SEGMENT, CLUSTER}):
            raise ValueError("an element is cut")
        if name in WEBM_METADATA:
            length = end - position - 5  # beside the id of one byte and a length of four
            edits.write(
                [(position, end)], bytes([VOID]) + (1 << 28 | length).to_bytes(4) + bytes(length)
            )
        position = end


def _free_metadata(edits: Edits, start: int, end: int, depth: int = 0) -> None:
    """Make each metadata box a `free` box of zeros."""
    for kind, begin, content, close in _boxes(edits.data, start, end):
        if kind in MP4_METADATA:
            edits.write([(begin + 4, begin + 8)], b"free")
            edits.blank(content, close)
        elif depth < len(PATH) - 1 and kind == PATH[depth]:
            _free_metadata(edits, content, close, depth + 1)


def _mp4_tracks(data: Data, start: int, end: int, depth: int = 0) -> Iterator[bool]:
    """Yield for each track True if it is sound (ISO/IEC 14496-12). Raises ValueError for a cut box."""
    for kind, _, content, close in _boxes(data, start, end):
        if kind == PATH[depth] and kind != PATH[-1]:
            yield from _mp4_tracks(data, content, close, depth + 1)
        elif kind == PATH[depth]:
            yield data[content + 8 : content + 12] == b"soun"


def _boxes(data: Data, start: int, end: int) -> Iterator[tuple[bytes, int, int, int]]:
    """Yield each box's kind, its start, and the start and end of its content. Raises ValueError for a cut box."""
    position = start
    while position + 8 <= end:
        size, kind, head = (
            int.from_bytes(data[position : position + 4]),
            bytes(data[position + 4 : position + 8]),
            8,
        )
        if size == 1:
            size, head = int.from_bytes(data[position + 8 : position + 16]), 16
        size = size or end - position  # 0: to the end
        if size < head or position + size > end:
            raise ValueError("a box is cut")
        yield kind, position, position + head, position + size
        position += size
