"""Small photographs with known metadata, made by Pillow and pillow_heif, and the parts that they do not write."""

import io
import struct
import zlib

import numpy as np
import pillow_heif
from PIL import Image

WIDTH, HEIGHT = 96, 64
LATITUDE, LONGITUDE = 40.0 + 25.0 / 60 + 41.37 / 3600, -(86.0 + 54.0 / 60 + 49.13 / 3600)
LATITUDE_RATIONALS = ((40, 1), (25, 1), (413_700, 10_000))
LONGITUDE_RATIONALS = ((86, 1), (54, 1), (491_300, 10_000))
PLACE_WORDS = (b"40,25.6895N", b"86,54.8188W", b"West Lafayette", b"Indiana", b"Hovde Hall")
TAKEN_AT, MAKE, MODEL, FOCAL_35MM = "2026:03:01 12:30:00", "Acme", "Phone 9", 28

XMP = b"""<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:exif="http://ns.adobe.com/exif/1.0/" xmlns:xmp="http://ns.adobe.com/xap/1.0/"
 xmlns:photoshop="http://ns.adobe.com/photoshop/1.0/" xmlns:e="http://iptc.org/std/Iptc4xmpExt/2008-02-29/"
 exif:GPSLatitude="40,25.6895N" exif:GPSLongitude = '86,54.8188W' photoshop:City="West Lafayette" xmp:Rating="3">
<photoshop:State>Indiana</photoshop:State><xmp:Label>lunch</xmp:Label>
<e:LocationShown><rdf:Bag><rdf:li rdf:parseType="Resource"><e:City>West Lafayette</e:City>
<e:Sublocation>Hovde Hall</e:Sublocation></rdf:li></rdf:Bag></e:LocationShown>
</rdf:Description></rdf:RDF></x:xmpmeta><?xpacket end="w"?>"""


def picture() -> Image.Image:
    """Smooth, with noise enough that JPEG's data contain stuffed bytes."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    noise = np.random.default_rng(7).integers(0, 60, (HEIGHT, WIDTH, 3))
    smooth = np.stack([x * 2, y * 3, x + y], -1)
    return Image.fromarray((smooth + noise).clip(0, 255).astype(np.uint8))


def exif_block(order: str = "<", *, orientation: int = 1, gps: bool = True, thumbnail: bytes = b"") -> bytes:
    """A TIFF block with IFD0, Exif and GPS directories, and IFD1 with a thumbnail if there is one. order: < or >."""

    def directory(at, entries, following=0):
        """Entries (tag, type, value) -> the directory and, right after it, the values that do not fit."""
        body, values = b"", b""
        end = at + 2 + len(entries) * 12 + 4
        for tag, kind, value in entries:
            count = len(value) // {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1}[kind]
            place = value.ljust(4, b"\0") if len(value) <= 4 else struct.pack(order + "L", end + len(values))
            values += b"" if len(value) <= 4 else value + b"\0" * (len(value) % 2)
            body += struct.pack(order + "HHL", tag, kind, count) + place
        return struct.pack(order + "H", len(entries)) + body + struct.pack(order + "L", following) + values

    def short(value):
        return struct.pack(order + "H", value)

    def long(value):
        return struct.pack(order + "L", value)

    def rationals(*pairs):
        return b"".join(struct.pack(order + "LL", *pair) for pair in pairs)

    gps_entries = [
        (0, 1, bytes([2, 3, 0, 0])),
        (1, 2, b"N\0"),
        (2, 5, rationals(*LATITUDE_RATIONALS)),
        (3, 2, b"W\0"),
        (4, 5, rationals(*LONGITUDE_RATIONALS)),
        (5, 1, b"\0"),
        (6, 5, rationals((18_725, 100))),
        (7, 5, rationals((11, 1), (30, 1), (0, 1))),
        (27, 7, b"ASCII\0\0\0HYBRID-FIX"),
        (28, 7, b"ASCII\0\0\0Hovde Hall"),
        (29, 2, b"2026:03:01\0"),
    ]
    exif_entries = [(0x9003, 2, TAKEN_AT.encode() + b"\0"), (0x927C, 7, b"makers note"), (0xA405, 3, short(FOCAL_35MM))]

    def main_entries(exif_at, gps_at):
        entries = [(0x010F, 2, MAKE.encode() + b"\0"), (0x0110, 2, MODEL.encode() + b"\0")]
        entries += [(0x0112, 3, short(orientation)), (0x8769, 4, long(exif_at))]
        return [*entries, (0x8825, 4, long(gps_at))] if gps else entries

    exif_at = 8 + len(directory(8, main_entries(0, 0)))
    gps_at = exif_at + len(directory(exif_at, exif_entries))
    gps_ifd = directory(gps_at, gps_entries) if gps else b""
    next_at = gps_at + len(gps_ifd)
    main = directory(8, main_entries(exif_at, gps_at), next_at if thumbnail else 0)
    block = struct.pack("<2s" if order == "<" else ">2s", b"II" if order == "<" else b"MM") + short(42) + long(8)
    block += main + directory(exif_at, exif_entries) + gps_ifd
    if thumbnail:
        entries = [(0x0103, 3, short(6)), (0x0201, 4, long(next_at + 42)), (0x0202, 4, long(len(thumbnail)))]
        block += directory(next_at, entries) + thumbnail
    return block


def coordinate_bytes(order: str = "<") -> list[bytes]:
    """The rationals of the coordinates, as they stand in a block of this order."""
    return [struct.pack(order + "6L", *sum(pairs, ())) for pairs in (LATITUDE_RATIONALS, LONGITUDE_RATIONALS)]


def segment(marker: int, payload: bytes) -> bytes:
    return bytes([0xFF, marker]) + (len(payload) + 2).to_bytes(2) + payload


def exif_segment(block: bytes) -> bytes:
    return segment(0xE1, b"Exif\0\0" + block)


def jpeg(*segments: bytes, trailer: bytes = b"", **options) -> bytes:
    """A JPEG with these segments after its start mark and these bytes after its end mark."""
    stream = io.BytesIO()
    picture().save(stream, "JPEG", quality=90, **options)
    data = stream.getvalue()
    return data[:2] + b"".join(segments) + data[2:] + trailer


def xmp_segment(packet: bytes) -> bytes:
    return segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + packet)


def extended_xmp_segments(packet: bytes, cut: int) -> list[bytes]:
    header = b"http://ns.adobe.com/xmp/extension/\0" + b"0123456789ABCDEF" * 2 + len(packet).to_bytes(4)
    pieces = [(0, packet[:cut]), (cut, packet[cut:])]
    return [segment(0xE1, header + offset.to_bytes(4) + piece) for offset, piece in pieces]


def iptc_block() -> bytes:
    def dataset(number, value):
        return bytes([0x1C, 2, number]) + len(value).to_bytes(2) + value

    content = dataset(5, b"lunch") + dataset(90, b"West Lafayette") + dataset(92, b"Hovde Hall")
    content += dataset(95, b"Indiana") + dataset(101, b"USA") + dataset(120, b"apple and rice")
    return b"8BIM\x04\x04\0\0" + len(content).to_bytes(4) + content + b"\0" * (len(content) % 2)


def iptc_segment() -> bytes:
    return segment(0xED, b"Photoshop 3.0\0" + iptc_block())


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return len(data).to_bytes(4) + kind + data + zlib.crc32(kind + data).to_bytes(4)


def png(*chunks: bytes) -> bytes:
    """A PNG with these chunks after its header."""
    stream = io.BytesIO()
    picture().save(stream, "PNG")
    data = stream.getvalue()
    return data[:33] + b"".join(chunks) + data[33:]


def png_itxt(packet: bytes, *, compressed: bool = False) -> bytes:
    text = zlib.compress(packet) if compressed else packet
    return png_chunk(b"iTXt", b"XML:com.adobe.xmp\0" + bytes([compressed, 0]) + b"\0\0" + text)


def heic(*, exif: bytes | None = None, xmp: bytes | None = None, image: Image.Image | None = None) -> bytes:
    stream = io.BytesIO()
    options = {"exif": exif} if exif else {}
    if xmp:
        options["xmp"] = xmp
    pillow_heif.from_pillow(image or picture()).save(stream, quality=80, **options)
    return stream.getvalue()


def box(kind: bytes, content: bytes) -> bytes:
    return (len(content) + 8).to_bytes(4) + kind + content


def video() -> bytes:
    """The frame of an MP4 with a phone's two ways to tell its location."""
    xyz = box(b"\xa9xyz", b"\0\x12\x15\xc7+40.4282-086.9136/")
    loci = box(b"loci", b"\0\0\0\0\x15\xc7Hovde Hall\0\0" + struct.pack(">lll", -5696029, 2649464, 12_271_616))
    keys = box(b"keys", b"\0\0\0\0\0\0\0\1" + box(b"mdta", b"com.apple.quicktime.location.ISO6709"))
    value = box(b"data", b"\0\0\0\1\0\0\0\0" + b"+40.4282-086.9136+187.250/")
    meta = box(b"meta", b"\0\0\0\0" + keys + box(b"ilst", box(b"\0\0\0\1", value)))
    moov = box(b"moov", box(b"mvhd", bytes(100)) + box(b"udta", xyz + loci) + meta)
    return box(b"ftyp", b"mp42\0\0\0\0isommp42") + box(b"mdat", bytes(range(256)) * 4) + moov


def grid_heic(columns: int, rows: int, tile: int, turn: int = 0, *, names: int = 1, part: int | None = None) -> bytes:
    """The boxes of a HEIC whose primary item is a grid in `idat`, as iPhones write; its tiles hold no pixels.

    names: how often the grid names each tile. part: what it names in place of its tiles.
    """
    tiles = range(2, 2 + columns * rows)
    width, height = columns * tile - 10, rows * tile - 6
    infe = [box(b"infe", b"\2\0\0\0" + struct.pack(">HH", 1, 0) + b"grid\0")]
    infe += [box(b"infe", b"\2\0\0\0" + struct.pack(">HH", number, 0) + b"hvc1\0") for number in tiles]
    iinf = box(b"iinf", b"\0\0\0\0" + struct.pack(">H", len(infe)) + b"".join(infe))
    grid = struct.pack(">BBBBHH", 0, 0, rows - 1, columns - 1, width, height)
    named = [*tiles] * names if part is None else [part]
    dimg = box(b"dimg", struct.pack(f">HH{len(named)}H", 1, len(named), *named))
    ispe = [box(b"ispe", struct.pack(">LLL", 0, *size)) for size in ((width, height), (tile, tile))]
    ipco = box(b"ipco", b"".join(ispe) + box(b"irot", bytes([turn])))
    associations = struct.pack(">HBBB", 1, 2, 1, 0x83) + b"".join(struct.pack(">HBB", one, 1, 2) for one in tiles)
    ipma = box(b"ipma", b"\0\0\0\0" + struct.pack(">L", 1 + len(tiles)) + associations)

    def meta(mdat_at):
        placed = struct.pack(">HHHHLL", 1, 1, 0, 1, 0, len(grid))
        for index, number in enumerate(tiles):
            placed += struct.pack(">HHHHLL", number, 0, 0, 1, mdat_at + index * 16, 16)
        iloc = box(b"iloc", b"\1\0\0\0" + b"\x44\x00" + struct.pack(">H", 1 + len(tiles)) + placed)
        pitm = box(b"pitm", b"\0\0\0\0\0\1")
        rest = iinf + box(b"iref", b"\0\0\0\0" + dimg) + box(b"iprp", ipco + ipma) + box(b"idat", grid)
        return box(b"meta", b"\0\0\0\0" + box(b"hdlr", b"\0" * 8 + b"pict" + b"\0" * 13) + pitm + iloc + rest)

    ftyp = box(b"ftyp", b"heic\0\0\0\0mif1heic")
    return ftyp + meta(len(ftyp) + len(meta(0)) + 8) + box(b"mdat", bytes(16 * len(tiles)))


def webp(*, exif: bytes = b"", xmp: bytes = b"", **options) -> bytes:
    stream = io.BytesIO()
    picture().save(stream, "WEBP", exif=exif, xmp=xmp, **options)
    return stream.getvalue()


def webp_chunk(kind: bytes, data: bytes) -> bytes:
    return kind + len(data).to_bytes(4, "little") + data + b"\0" * (len(data) % 2)


def riff(*chunks: bytes) -> bytes:
    body = b"WEBP" + b"".join(chunks)
    return b"RIFF" + len(body).to_bytes(4, "little") + body


def animated_webp() -> bytes:
    stream = io.BytesIO()
    picture().save(stream, "WEBP", save_all=True, append_images=[picture().transpose(Image.Transpose.ROTATE_180)])
    return stream.getvalue()
