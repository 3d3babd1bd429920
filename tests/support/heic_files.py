"""HEIC files with an auxiliary image beside the photograph, as phones write a depth map: made of pillow_heif's files.

pillow_heif writes several pictures into a file, but none as auxiliary to another: the boxes that say so are added here.
"""

import io
import struct
from collections.abc import Iterator

import numpy as np
import pillow_heif

DEPTH = b"urn:mpeg:hevc:2015:auxid:2"
MATTE = b"urn:com:apple:photo:2018:aux:portraiteffectsmatte"
GREY = int.from_bytes(b"L008")
# The keys that an iPhone writes beside a portrait's disparity map; the lens's calibration stands between them.
PACKET = """<x:xmpmeta xmlns:x="adobe:ns:meta/" x:xmptk="XMP Core 6.0.0">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about=""
   xmlns:apdi="http://ns.apple.com/pixeldatainfo/1.0/" xmlns:depthData="http://ns.apple.com/depthData/1.0/">
  <apdi:IntMaxValue>255</apdi:IntMaxValue><apdi:StoredFormat>{grey}</apdi:StoredFormat>
  <apdi:NativeFormat>{native}</apdi:NativeFormat><apdi:IntMinValue>0</apdi:IntMinValue>
  <apdi:FloatMaxValue>{high}</apdi:FloatMaxValue><apdi:FloatMinValue>{low}</apdi:FloatMinValue>
  <apdi:AuxiliaryImageType>{kind}</apdi:AuxiliaryImageType>
  <depthData:DepthDataVersion>65541</depthData:DepthDataVersion><depthData:Quality>high</depthData:Quality>
  <depthData:Accuracy>{accuracy}</depthData:Accuracy><depthData:Filtered>True</depthData:Filtered>
 </rdf:Description></rdf:RDF></x:xmpmeta>"""


def packet(low: object, high: object, *, accuracy: str = "relative", native: str = "hdis") -> bytes:
    """The XMP of a map whose levels 0 to 255 lie between low and high, 1/m (hdis) or m (hdep)."""
    kind = "depth" if native.endswith("dep") else "disparity"
    number = int.from_bytes(native.encode())
    return PACKET.format(grey=GREY, native=number, low=low, high=high, kind=kind, accuracy=accuracy).encode()


def quantised(values: np.ndarray) -> tuple[np.ndarray, float, float]:
    """(h, w) numbers as 8 bit levels between the lowest and the highest of them, which follow."""
    low, high = float(values.min()), float(values.max())
    return np.rint((values - low) / (high - low) * 255).astype(np.uint8), low, high


def heic_with_map(
    rgb: np.ndarray,
    levels: np.ndarray,
    xmp: bytes | None,
    *,
    urn: bytes = DEPTH,
    exif: bytes | None = None,
    is_map_turned: bool = True,
    quality: int = 95,
    times: int = 1,
) -> bytes:
    """A HEIC of the picture, (H, W, 3), with the levels, (h, w) or (h, w, 3) of 8 or 16 bits, as auxiliary image.

    exif: its orientation turns the picture and, if is_map_turned, the map. times: that the map is referred to.
    """
    file = pillow_heif.HeifFile()
    for pixels in (rgb, levels):
        mode = ("L" if pixels.ndim == 2 else "RGB") + (";16" if pixels.dtype == np.uint16 else "")
        file.add_frombytes(mode, pixels.shape[1::-1], np.ascontiguousarray(pixels).tobytes())
    if exif is not None:
        for image in list(file)[: 2 if is_map_turned else 1]:
            image.info["exif"] = exif
    if xmp is not None:
        file[1].info["xmp"] = xmp
    stream = io.BytesIO()
    file.save(stream, quality=quality, primary_index=0)
    return _second_as_auxiliary(stream.getvalue(), urn, times)


def _boxes(data: bytes, start: int, end: int) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of each box."""
    while start < end:
        size = int.from_bytes(data[start : start + 4])
        yield data[start + 4 : start + 8], data[start + 8 : start + size]
        start += size


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">L4s", len(content) + 8, kind) + content


def _second_as_auxiliary(data: bytes, urn: bytes, times: int) -> bytes:
    """The file of two pictures with the second as auxiliary to the first: properties, references, moved places."""
    parts = dict(_boxes(data, 0, len(data)))
    children = dict(_boxes(parts[b"meta"], 4, len(parts[b"meta"])))
    properties = dict(_boxes(children[b"iprp"], 0, len(children[b"iprp"])))
    count = sum(1 for _ in _boxes(properties[b"ipco"], 0, len(properties[b"ipco"])))
    properties[b"ipco"] += _box(b"auxC", b"\0\0\0\0" + urn + b"\0")
    first, second = _picture_ids(children[b"iinf"])
    properties[b"ipma"] = _with_property(properties[b"ipma"], second, count + 1)
    children[b"iprp"] = b"".join(_box(kind, content) for kind, content in properties.items())
    references = children.get(b"iref", b"\0\0\0\0")
    children[b"iref"] = references + _box(b"auxl", struct.pack(">HHH", second, 1, first)) * times
    length = 4 + sum(len(content) + 8 for content in children.values())
    children[b"iloc"] = _moved(children[b"iloc"], length - len(parts[b"meta"]))
    parts[b"meta"] = parts[b"meta"][:4] + b"".join(_box(kind, content) for kind, content in children.items())
    return b"".join(_box(kind, content) for kind, content in parts.items())


def _picture_ids(iinf: bytes) -> list[int]:
    entries = [content for _, content in _boxes(iinf, 6, len(iinf))]
    return [int.from_bytes(entry[4:6]) for entry in entries if entry[8:12] == b"hvc1"]


def _with_property(ipma: bytes, item: int, index: int) -> bytes:
    out, at = ipma[:8], 8
    for _ in range(int.from_bytes(ipma[4:8])):
        item_id, count = struct.unpack_from(">HB", ipma, at)
        own = ipma[at + 3 : at + 3 + count]
        own += bytes([0x80 | index]) if item_id == item else b""
        out += struct.pack(">HB", item_id, len(own)) + own
        at += 3 + count
    return out


def _moved(iloc: bytes, by: int) -> bytes:
    """Items' places with all offsets moved; of iloc's version 0 with numbers of four bytes, one extent per item."""
    out, at = iloc[:8], 8
    for _ in range(int.from_bytes(iloc[6:8])):
        item, reference, base, count, offset, length = struct.unpack_from(">HHLHLL", iloc, at)
        out += struct.pack(">HHLHLL", item, reference, base, count, offset + by, length)
        at += 18
    return out
