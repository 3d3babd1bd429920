"""Voice notes as browsers record them, cut down to what tells their kind: headers and tracks."""


def element(name, content=b""):
    """An EBML element; its length takes four bytes."""
    return bytes.fromhex(name) + (0x10000000 | len(content)).to_bytes(4) + content


def webm(*track_types, doc_type=b"webm", sound=b"", is_open=True):
    """A WebM file with tracks of these types (1: video, 2: audio); is_open: a segment of unknown length."""
    header = element("1a45dfa3", element("4282", doc_type))
    tracks = element("1654ae6b", b"".join(element("ae", element("83", bytes([kind]))) for kind in track_types))
    segment = element("1549a966") + tracks + element("1f43b675", sound)
    if is_open:
        return header + bytes.fromhex("18538067") + bytes.fromhex("01ffffffffffffff") + segment
    return header + element("18538067", segment)


def box(kind, content=b""):
    """An MP4 box."""
    return (8 + len(content)).to_bytes(4) + kind + content


def mp4(*handlers, sound=b""):
    """An MP4 file with tracks of these handlers, such as b"soun"."""
    tracks = b"".join(box(b"trak", box(b"mdia", box(b"hdlr", bytes(8) + handler + bytes(12)))) for handler in handlers)
    return box(b"ftyp", b"iso5") + box(b"mdat", sound) + box(b"moov", tracks)
