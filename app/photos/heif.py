"""The layout of a HEIC file (ISO/IEC 23008-12 in the boxes of 14496-12): boxes, primary item, items that hold metadata.

The size is that of the primary item's `ispe`, cropped by its `clap`; the orientation is that of its `irot` and `imir`,
written as the EXIF orientation of the same effect. EXIF's own orientation tag does not count in HEIC.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from app.core.errors import Failure
from app.photos.byte_file import Data, Extent
from app.photos.layout import DamageError, Layout, Part, damage_recorded, truncated, unreadable

MAX_STEPS = 50_000  # boxes, items, extents and properties together; a 48 MP photograph of 512 px tiles has some 2,000
MAX_URN = 256
MAX_AUXILIARIES = 16  # of a picture, and descriptions of each: an iPhone has some five
MAX_DEPTH = 2  # of pictures made of others: a turned copy of a grid of tiles
PRIMARY_TYPES = frozenset({b"hvc1", b"hev1", b"grid", b"iden", b"iovl"})

# EXIF orientation of each way to turn a picture, as the matrix that maps (x to the right, y down) as stored to upright.
ORIENTATIONS = {
    (1, 0, 0, 1): 1,
    (-1, 0, 0, 1): 2,
    (-1, 0, 0, -1): 3,
    (1, 0, 0, -1): 4,
    (0, 1, 1, 0): 5,
    (0, -1, 1, 0): 6,
    (0, -1, -1, 0): 7,
    (0, 1, -1, 0): 8,
}


@dataclass(frozen=True, slots=True)
class HeifItem:
    """An item: its type, its content type if it is `mime`, and its bytes in the file."""

    kind: bytes
    content_type: bytes
    extents: tuple[Extent, ...]

    @property
    def is_xmp(self) -> bool:
        """Whether it is an XMP packet."""
        return self.kind == b"mime" and self.content_type == b"application/rdf+xml"


@dataclass(frozen=True, slots=True)
class HeifAuxiliary:
    """A picture that belongs to the primary one, such as a depth map: its size upright, px, and its orientation.

    urn: what it is (auxC). pixels_to_decode: as of the layout. packets: where metadata that describe it stand.
    """

    urn: bytes
    width: int
    height: int
    orientation: int
    pixels_to_decode: int
    packets: tuple[tuple[Extent, ...], ...]


@dataclass(slots=True)
class HeifLayout(Layout):
    """Boxes, and what their `meta` box tells: items, the primary item's picture and what is auxiliary to it.

    width, height: as stored and cropped. orientation: EXIF's. pixels_to_decode: before cropping, and of all pictures
    that it is put together from, each as often as it is named.
    """

    items: tuple[HeifItem, ...] = ()
    auxiliaries: tuple[HeifAuxiliary, ...] = ()
    orientation: int = 1
    pixels_to_decode: int = 0


class _Reader:
    """Big-endian numbers one after the other, within bounds."""

    def __init__(self, data: Data, start: int, end: int) -> None:
        self.data, self.position, self.end = data, start, end

    def take(self, size: int) -> bytes:
        if size > self.end - self.position:
            raise unreadable("a HEIC box is shorter than its content")
        self.position += size
        return self.data[self.position - size : self.position]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size))

    def version_and_flags(self) -> tuple[int, int]:
        return self.number(1), self.number(3)


@dataclass(slots=True)
class _File:
    """A file under reading, and what its `meta` box tells, by item id.

    steps_left: keeps the time linear whatever the counts in the file say.
    """

    data: Data
    steps_left: int = MAX_STEPS
    primary: int | None = None
    types: dict[int, tuple[bytes, bytes]] = field(default_factory=dict)
    extents: dict[int, tuple[Extent, ...]] = field(default_factory=dict)
    properties: list[Part] = field(default_factory=list)
    associations: dict[int, list[int]] = field(default_factory=dict)
    # of derived pictures: grids, overlays
    parts: dict[int, list[int]] = field(default_factory=dict)
    auxiliaries: dict[int, list[int]] = field(default_factory=dict)  # of a picture
    descriptions: dict[int, list[int]] = field(default_factory=dict)  # of a picture: its metadata
    has_auxiliaries: bool = False
    # pixels that an item makes, by item and depth
    pixels: dict[tuple[int, int], int] = field(default_factory=dict)

    def spend(self) -> None:
        self.steps_left -= 1
        if self.steps_left < 0:
            raise unreadable(f"the HEIC has more than {MAX_STEPS} parts")

    def counted(self, count: int) -> Iterator[None]:
        """As many steps, each spent as it begins."""
        for _ in range(count):
            self.spend()
            yield

    def reader(self, box: Part) -> _Reader:
        return _Reader(self.data, box.start, box.end)

    def boxes(self, start: int, end: int) -> Iterator[Part]:
        """The boxes from start to end."""
        data, position = self.data, start
        while position + 8 <= end:
            self.spend()
            size, kind, content = (
                int.from_bytes(data[position : position + 4]),
                data[position + 4 : position + 8],
                8,
            )
            if size == 1:
                size, content = int.from_bytes(data[position + 8 : position + 16]), 16
            elif size == 0:  # to the end
                size = end - position
            if size < content:
                raise unreadable("a HEIC box has an impossible length")
            if size > end - position:
                raise truncated("a HEIC box is cut")
            yield Part(kind, position + content, position + size)
            position += size


def read_heif_layout(data: Data, *, has_auxiliaries: bool = False) -> HeifLayout:
    """Walk the boxes of the file and the items of its `meta` box. The file begins with `ftyp`.

    has_auxiliaries: read what is auxiliary to the primary picture, too, which nobody needs on arrival.
    """
    file = _File(data, has_auxiliaries=has_auxiliaries)
    layout = HeifLayout()
    with damage_recorded(layout):
        for box in file.boxes(0, len(data)):
            layout.parts.append(box)
            layout.end = box.end
    meta = next((box for box in layout.parts if box.kind == b"meta"), None)
    if meta is None or file.steps_left < 0:
        if layout.damage is None:
            has_video = any(box.kind == b"moov" for box in layout.parts)
            error = (
                unreadable("the HEIC has no still picture")
                if has_video
                else truncated("the HEIC has no content")
            )
            layout.damage = error.damage
        return layout
    # past the boxes may be a maker's record, or a cut video: the items' places decide
    layout.damage = None
    with damage_recorded(layout):
        _read_meta(file, meta)
        _read_primary_picture(file, layout)
    if has_auxiliaries and layout.damage is None:
        with damage_recorded(Layout()):  # the photograph is sound without them
            ids = _unique(file.auxiliaries.get(file.primary or 0, []))
            layout.auxiliaries = tuple(_auxiliary(file, item_id) for item_id in ids)
    layout.items = tuple(
        HeifItem(*file.types.get(item_id, (b"", b"")), extents)
        for item_id, extents in file.extents.items()
    )
    return layout


def _read_meta(file: _File, meta: Part) -> None:
    children: dict[bytes, Part] = {}
    for box in file.boxes(meta.start + 4, meta.end):
        children.setdefault(box.kind, box)
    for kind in (b"pitm", b"iinf", b"iloc", b"iprp"):
        if kind not in children:
            raise unreadable(f"the HEIC has no {kind.decode()} box")
    _read_item_types(file, children[b"iinf"])
    idat = children.get(b"idat")
    _read_item_locations(file, children[b"iloc"], (idat.start, idat.end) if idat else None)
    reader = file.reader(children[b"pitm"])
    version, _ = reader.version_and_flags()
    file.primary = reader.number(2 if version == 0 else 4)
    for box in file.boxes(children[b"iprp"].start, children[b"iprp"].end):
        if box.kind == b"ipco":
            file.properties.extend(file.boxes(box.start, box.end))
        elif box.kind == b"ipma":
            _read_associations(file, box)
    if b"iref" in children:
        _read_references(file, children[b"iref"])


def _read_item_types(file: _File, iinf: Part) -> None:
    reader = file.reader(iinf)
    version, _ = reader.version_and_flags()
    reader.number(2 if version == 0 else 4)  # the count; the boxes tell it again
    for box in file.boxes(reader.position, iinf.end):
        entry = file.reader(box)
        version, _ = entry.version_and_flags()
        if box.kind != b"infe" or version < 2:
            continue  # versions 0 and 1 know no item types and stand in no HEIC
        item_id = entry.number(2 if version == 2 else 4)
        entry.number(2)  # protection
        kind = entry.take(4)
        # item name, then content type
        names = entry.take(min(1024, box.end - entry.position)).split(b"\0")
        file.types[item_id] = (kind, names[1] if kind == b"mime" and len(names) > 1 else b"")


def _read_item_locations(file: _File, iloc: Part, idat: Extent | None) -> None:
    reader = file.reader(iloc)
    version, _ = reader.version_and_flags()
    sizes = reader.number(2)
    offset_size, length_size, base_size = sizes >> 12, sizes >> 8 & 15, sizes >> 4 & 15
    index_size = sizes & 15 if version in {1, 2} else 0
    # extents may overlap; all metadata together may still not pass the file's length
    metadata_left = len(file.data)
    for _ in file.counted(reader.number(2 if version < 2 else 4)):
        item_id = reader.number(2 if version < 2 else 4)
        method = reader.number(2) & 15 if version in {1, 2} else 0
        is_elsewhere = reader.number(2) != 0
        base = reader.number(base_size)
        extents = []
        for _ in file.counted(reader.number(2)):
            reader.number(index_size)
            offset, length = base + reader.number(offset_size), reader.number(length_size)
            extents.append((offset, length))
        container = {0: (0, len(file.data)), 1: idat}.get(method)
        if is_elsewhere or container is None:
            raise unreadable("a HEIC item lies outside the file")
        placed = tuple(_placed(container, offset, length) for offset, length in extents)
        if file.types.get(item_id, (b"",))[0] in {b"Exif", b"mime", b"uri "}:
            metadata_left -= sum(end - start for start, end in placed)
            if metadata_left < 0:
                raise unreadable("the HEIC's metadata are longer than the file")
        file.extents[item_id] = placed


def _placed(container: Extent, offset: int, length: int) -> Extent:
    """An extent in the file; a length of 0 means all of its container."""
    start = container[0] + offset
    end = start + length if length else container[1]
    if start > container[1] or end > container[1]:
        raise truncated("a HEIC item is cut")
    return start, end


def _read_associations(file: _File, ipma: Part) -> None:
    reader = file.reader(ipma)
    version, flags = reader.version_and_flags()
    for _ in file.counted(reader.number(4)):
        item_id = reader.number(2 if version == 0 else 4)
        for _ in file.counted(reader.number(1)):
            index = reader.number(2) & 0x7FFF if flags & 1 else reader.number(1) & 0x7F
            file.associations.setdefault(item_id, []).append(index)


def _read_references(file: _File, iref: Part) -> None:
    version, _ = file.reader(iref).version_and_flags()
    size = 2 if version == 0 else 4
    of_target = (
        {b"auxl": file.auxiliaries, b"cdsc": file.descriptions} if file.has_auxiliaries else {}
    )
    for box in file.boxes(iref.start + 4, iref.end):
        if box.kind != b"dimg" and box.kind not in of_target:
            continue
        reader = file.reader(box)
        source = reader.number(size)
        for _ in file.counted(reader.number(2)):
            target = reader.number(size)
            if box.kind == b"dimg":
                file.parts.setdefault(source, []).append(target)
            else:
                of_target[box.kind].setdefault(target, []).append(source)


def _pixels_of_parts(file: _File, item_id: int, depth: int = 0) -> int:
    """What decoding an item makes: its own pixels, or those of all its parts where these are more."""
    if depth > MAX_DEPTH:
        raise unreadable("the HEIC's pictures are made of one another")
    if (item_id, depth) not in file.pixels:  # any number of pictures may name it
        width, height = _declared_size(file, item_id)
        total = sum(_pixels_of_parts(file, part, depth + 1) for part in file.parts.get(item_id, []))
        file.pixels[item_id, depth] = max(width * height, total)
    return file.pixels[item_id, depth]


def _properties(file: _File, item_id: int) -> list[Part]:
    """In the order in which they apply."""
    indices = [
        index for index in file.associations.get(item_id, []) if 1 <= index <= len(file.properties)
    ]
    return [file.properties[index - 1] for index in indices]


def _read_primary_picture(file: _File, layout: HeifLayout) -> None:
    """Read the primary item's picture, by its properties in the order in which they apply."""
    if file.primary is None or not file.extents.get(file.primary):
        raise unreadable("the HEIC's main picture is missing")
    kind = file.types.get(file.primary, (b"", b""))[0]
    if kind not in PRIMARY_TYPES:
        raise DamageError(_other_coding(kind))
    size = _declared_size(file, file.primary)
    if 0 in size:
        raise unreadable("the HEIC's main picture has no size")
    pixels_to_decode = _pixels_of_parts(file, file.primary)
    size, layout.orientation = _turned(file, file.primary, size)
    layout.pixels_to_decode = pixels_to_decode
    layout.width, layout.height = size if layout.orientation <= 4 else (size[1], size[0])


def _unique(item_ids: Sequence[int]) -> list[int]:
    """At most MAX_AUXILIARIES items, each once: a file may name one thousands of times."""
    return list(dict.fromkeys(item_ids))[:MAX_AUXILIARIES]


def _auxiliary(file: _File, item_id: int) -> HeifAuxiliary:
    size, orientation = _turned(file, item_id, _declared_size(file, item_id))
    urn = b""
    for box in _properties(file, item_id):
        if box.kind == b"auxC":
            reader = file.reader(box)
            reader.version_and_flags()
            urn = reader.take(min(MAX_URN, box.end - reader.position)).split(b"\0")[0]
    descriptions = _unique(file.descriptions.get(item_id, []))
    packets = [each for each in descriptions if file.types.get(each, (b"",))[0] == b"mime"]
    places = tuple(file.extents[each] for each in packets if each in file.extents)
    return HeifAuxiliary(urn, *size, orientation, _pixels_of_parts(file, item_id), places)


def _turned(file: _File, item_id: int, size: tuple[int, int]) -> tuple[tuple[int, int], int]:
    """An item's size upright, and EXIF's orientation of the same turn."""
    turn = (1, 0, 0, 1)
    for box in _properties(file, item_id):
        reader = file.reader(box)
        if box.kind == b"clap":
            size = _cropped(reader, size)
        elif box.kind == b"irot":
            for _ in range(reader.number(1) & 3):  # quarters, counter-clockwise
                turn = (turn[2], turn[3], -turn[0], -turn[1])
                size = (size[1], size[0])
        elif box.kind == b"imir":
            is_left_right = reader.number(1) & 1
            turn = (
                (-turn[0], -turn[1], *turn[2:])
                if is_left_right
                else (*turn[:2], -turn[2], -turn[3])
            )
    return size, ORIENTATIONS[turn]


def _declared_size(file: _File, item_id: int) -> tuple[int, int]:
    """An item's width and height, px; zeros where it tells none."""
    for box in _properties(file, item_id):
        if box.kind == b"ispe":
            reader = file.reader(box)
            reader.version_and_flags()
            return reader.number(4), reader.number(4)
    return 0, 0


def _cropped(reader: _Reader, size: tuple[int, int]) -> tuple[int, int]:
    """The size that a clean aperture leaves; the whole size if it makes no sense."""
    width, width_per, height, height_per = (reader.number(4) for _ in range(4))
    if not (width_per and height_per and width and height):
        return size
    return min(max(width // width_per, 1), size[0]), min(max(height // height_per, 1), size[1])


def _other_coding(kind: bytes) -> Failure:
    what = "an AVIF picture" if kind == b"av01" else "a HEIF picture in another coding than HEVC"
    return Failure(
        "not_an_image",
        f"The file looks like {what}, which is not read.",
        "Send a JPEG, PNG, WebP or HEIC file.",
    )
