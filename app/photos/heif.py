"""The layout of a HEIC file (ISO/IEC 23008-12 in the boxes of 14496-12): boxes, primary item, items that hold metadata.

The size is that of the primary item's `ispe`, cropped by its `clap`; the orientation is that of its `irot` and `imir`,
written as the EXIF orientation of the same effect. EXIF's own orientation tag does not count in HEIC.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

from app.core.errors import Failure
from app.photos.byte_file import Data, Extent
from app.photos.damage import truncated, unreadable

MAX_STEPS = 50_000  # boxes, items, extents and properties together; a 48 MP photograph of 512 px tiles has some 2,000
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
class Box:
    """A box's type and where it and its content are."""

    kind: bytes
    at: int
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class HeifItem:
    """An item: its type, its content type if it is `mime`, and its bytes in the file."""

    kind: bytes
    content_type: bytes
    extents: tuple[Extent, ...]


@dataclass(frozen=True, slots=True)
class HeifPicture:
    """The primary item's size as stored and cropped, its EXIF orientation, and the pixels that a decoder makes.

    pixels_to_decode: before cropping, and of all pictures that it is put together from, each as often as it is named.
    """

    width: int
    height: int
    orientation: int
    pixels_to_decode: int


NO_PICTURE = HeifPicture(0, 0, 1, 0)


@dataclass(frozen=True, slots=True)
class HeifLayout:
    """What was read, up to the file's end or the damage; the picture has no size if the damage came before it."""

    boxes: tuple[Box, ...]
    items: tuple[HeifItem, ...]
    picture: HeifPicture
    end: int
    damage: Failure | None


class _BrokenError(Exception):
    """Ends the reading at the damage; never leaves this module."""

    def __init__(self, damage: Failure) -> None:
        super().__init__(damage.message)
        self.damage = damage


@dataclass(slots=True)
class _Steps:
    """What may still be read: it keeps the time linear whatever the counts in the file say."""

    left: int = MAX_STEPS

    def spend(self) -> None:
        self.left -= 1
        if self.left < 0:
            raise _BrokenError(unreadable(f"the HEIC has more than {MAX_STEPS} parts"))


class _Reader:
    """Big-endian numbers one after the other, within bounds."""

    def __init__(self, data: Data, start: int, end: int) -> None:
        self.data, self.position, self.end = data, start, end

    def take(self, size: int) -> bytes:
        if size > self.end - self.position:
            raise _BrokenError(unreadable("a HEIC box is shorter than its content"))
        self.position += size
        return self.data[self.position - size : self.position]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size))

    def version_and_flags(self) -> tuple[int, int]:
        return self.number(1), self.number(3)


@dataclass(slots=True)
class _Meta:
    """What the `meta` box tells, by item id."""

    primary: int | None = None
    types: dict[int, tuple[bytes, bytes]] = field(default_factory=dict)
    extents: dict[int, tuple[Extent, ...]] = field(default_factory=dict)
    properties: list[Box] = field(default_factory=list)
    associations: dict[int, list[int]] = field(default_factory=dict)
    parts: dict[int, list[int]] = field(default_factory=dict)  # of derived pictures: grids, overlays


def read_heif_layout(data: Data) -> HeifLayout:
    """Walk the boxes of the file and the items of its `meta` box. The file begins with `ftyp`."""
    steps = _Steps()
    boxes: list[Box] = []
    end = 0
    damage: Failure | None = None
    try:
        for box in _boxes(data, 0, len(data), steps):
            boxes.append(box)
            end = box.end
    except _BrokenError as error:
        damage = error.damage
    metas = [box for box in boxes if box.kind == b"meta"]
    if not metas or steps.left < 0:
        if damage is None:
            has_video = any(box.kind == b"moov" for box in boxes)
            damage = unreadable("the HEIC has no still picture") if has_video else truncated("the HEIC has no content")
        return HeifLayout(tuple(boxes), (), NO_PICTURE, end, damage)
    meta = _Meta()
    picture = NO_PICTURE
    damage = None  # past the boxes may be a maker's record, or an appended video that is cut: the items' places decide
    try:
        _read_meta(data, metas[0], meta, steps)
        picture = _primary_picture(data, meta)
    except _BrokenError as error:
        damage = error.damage
    items = tuple(HeifItem(*meta.types.get(item_id, (b"", b"")), extents) for item_id, extents in meta.extents.items())
    return HeifLayout(tuple(boxes), items, picture, end, damage)


def _boxes(data: Data, start: int, end: int, steps: _Steps) -> Iterator[Box]:
    """The boxes from start to end."""
    position = start
    while position + 8 <= end:
        steps.spend()
        size, kind, content = int.from_bytes(data[position : position + 4]), data[position + 4 : position + 8], 8
        if size == 1:
            size, content = int.from_bytes(data[position + 8 : position + 16]), 16
        elif size == 0:  # to the end
            size = end - position
        if size < content:
            raise _BrokenError(unreadable("a HEIC box has an impossible length"))
        if size > end - position:
            raise _BrokenError(truncated("a HEIC box is cut"))
        yield Box(kind, position, position + content, position + size)
        position += size


def _read_meta(data: Data, meta_box: Box, meta: _Meta, steps: _Steps) -> None:
    children: dict[bytes, Box] = {}
    for box in _boxes(data, meta_box.start + 4, meta_box.end, steps):
        children.setdefault(box.kind, box)
    for kind in (b"pitm", b"iinf", b"iloc", b"iprp"):
        if kind not in children:
            raise _BrokenError(unreadable(f"the HEIC has no {kind.decode()} box"))
    _read_item_types(data, children[b"iinf"], meta, steps)
    idat = children.get(b"idat")
    _read_item_locations(data, children[b"iloc"], (idat.start, idat.end) if idat else None, meta, steps)
    reader = _Reader(data, children[b"pitm"].start, children[b"pitm"].end)
    version, _ = reader.version_and_flags()
    meta.primary = reader.number(2 if version == 0 else 4)
    for box in _boxes(data, children[b"iprp"].start, children[b"iprp"].end, steps):
        if box.kind == b"ipco":
            meta.properties.extend(_boxes(data, box.start, box.end, steps))
        elif box.kind == b"ipma":
            _read_associations(data, box, meta, steps)
    if b"iref" in children:
        _read_parts(data, children[b"iref"], meta, steps)


def _read_item_types(data: Data, iinf: Box, meta: _Meta, steps: _Steps) -> None:
    reader = _Reader(data, iinf.start, iinf.end)
    version, _ = reader.version_and_flags()
    reader.number(2 if version == 0 else 4)  # the count; the boxes tell it again
    for box in _boxes(data, reader.position, iinf.end, steps):
        entry = _Reader(data, box.start, box.end)
        version, _ = entry.version_and_flags()
        if box.kind != b"infe" or version < 2:
            continue  # versions 0 and 1 know no item types and stand in no HEIC
        item_id = entry.number(2 if version == 2 else 4)
        entry.number(2)  # protection
        kind = entry.take(4)
        names = entry.take(min(1024, box.end - entry.position)).split(b"\0")  # item name, then content type
        meta.types[item_id] = (kind, names[1] if kind == b"mime" and len(names) > 1 else b"")


def _read_item_locations(data: Data, iloc: Box, idat: Extent | None, meta: _Meta, steps: _Steps) -> None:
    reader = _Reader(data, iloc.start, iloc.end)
    version, _ = reader.version_and_flags()
    sizes = reader.number(2)
    offset_size, length_size, base_size = sizes >> 12, sizes >> 8 & 15, sizes >> 4 & 15
    index_size = sizes & 15 if version in {1, 2} else 0
    metadata_left = len(data)  # extents may overlap; all metadata together may still not pass the file's length
    for _ in range(reader.number(2 if version < 2 else 4)):
        steps.spend()
        item_id = reader.number(2 if version < 2 else 4)
        method = reader.number(2) & 15 if version in {1, 2} else 0
        is_elsewhere = reader.number(2) != 0
        base = reader.number(base_size)
        extents = []
        for _ in range(reader.number(2)):
            steps.spend()
            reader.number(index_size)
            offset, length = base + reader.number(offset_size), reader.number(length_size)
            extents.append((offset, length))
        container = {0: (0, len(data)), 1: idat}.get(method)
        if is_elsewhere or container is None:
            raise _BrokenError(unreadable("a HEIC item lies outside the file"))
        placed = tuple(_placed(container, offset, length) for offset, length in extents)
        if meta.types.get(item_id, (b"",))[0] in {b"Exif", b"mime", b"uri "}:
            metadata_left -= sum(end - start for start, end in placed)
            if metadata_left < 0:
                raise _BrokenError(unreadable("the HEIC's metadata are longer than the file"))
        meta.extents[item_id] = placed


def _placed(container: Extent, offset: int, length: int) -> Extent:
    """An extent in the file; a length of 0 means all of its container."""
    start = container[0] + offset
    end = start + length if length else container[1]
    if start > container[1] or end > container[1]:
        raise _BrokenError(truncated("a HEIC item is cut"))
    return start, end


def _read_associations(data: Data, ipma: Box, meta: _Meta, steps: _Steps) -> None:
    reader = _Reader(data, ipma.start, ipma.end)
    version, flags = reader.version_and_flags()
    for _ in range(reader.number(4)):
        steps.spend()
        item_id = reader.number(2 if version == 0 else 4)
        for _ in range(reader.number(1)):
            steps.spend()
            index = reader.number(2) & 0x7FFF if flags & 1 else reader.number(1) & 0x7F
            meta.associations.setdefault(item_id, []).append(index)


def _read_parts(data: Data, iref: Box, meta: _Meta, steps: _Steps) -> None:
    version, _ = _Reader(data, iref.start, iref.end).version_and_flags()
    size = 2 if version == 0 else 4
    for box in _boxes(data, iref.start + 4, iref.end, steps):
        if box.kind != b"dimg":
            continue
        reader = _Reader(data, box.start, box.end)
        whole = reader.number(size)
        for _ in range(reader.number(2)):
            steps.spend()
            meta.parts.setdefault(whole, []).append(reader.number(size))


def _pixels_of_parts(data: Data, item_id: int, meta: _Meta, depth: int = 0) -> int:
    """What decoding an item makes: its own pixels, or those of all its parts where these are more."""
    if depth > MAX_DEPTH:
        raise _BrokenError(unreadable("the HEIC's pictures are made of one another"))
    width, height = next(
        (_declared_size(data, box) for box in _properties(item_id, meta) if box.kind == b"ispe"), (0, 0)
    )
    of_part: dict[int, int] = {}
    total = 0
    for part in meta.parts.get(item_id, []):
        if part not in of_part:
            of_part[part] = _pixels_of_parts(data, part, meta, depth + 1)
        total += of_part[part]
    return max(width * height, total)


def _properties(item_id: int, meta: _Meta) -> list[Box]:
    """In the order in which they apply."""
    indices = [index for index in meta.associations.get(item_id, []) if 1 <= index <= len(meta.properties)]
    return [meta.properties[index - 1] for index in indices]


def _primary_picture(data: Data, meta: _Meta) -> HeifPicture:
    """The primary item's picture, by its properties in the order in which they apply."""
    if meta.primary is None or not meta.extents.get(meta.primary):
        raise _BrokenError(unreadable("the HEIC's main picture is missing"))
    kind = meta.types.get(meta.primary, (b"", b""))[0]
    if kind not in PRIMARY_TYPES:
        raise _BrokenError(_other_coding(kind))
    boxes = _properties(meta.primary, meta)
    size = next((_declared_size(data, box) for box in boxes if box.kind == b"ispe"), (0, 0))
    if 0 in size:
        raise _BrokenError(unreadable("the HEIC's main picture has no size"))
    pixels_to_decode = _pixels_of_parts(data, meta.primary, meta)
    turn = (1, 0, 0, 1)
    for box in boxes:
        reader = _Reader(data, box.start, box.end)
        if box.kind == b"clap":
            size = _cropped(reader, size)
        elif box.kind == b"irot":
            for _ in range(reader.number(1) & 3):  # quarters, counter-clockwise
                turn = (turn[2], turn[3], -turn[0], -turn[1])
                size = (size[1], size[0])
        elif box.kind == b"imir":
            is_left_right = reader.number(1) & 1
            turn = (-turn[0], -turn[1], *turn[2:]) if is_left_right else (*turn[:2], -turn[2], -turn[3])
    orientation = ORIENTATIONS[turn]
    width, height = size if orientation <= 4 else (size[1], size[0])
    return HeifPicture(width, height, orientation, pixels_to_decode)


def _declared_size(data: Data, ispe: Box) -> tuple[int, int]:
    reader = _Reader(data, ispe.start, ispe.end)
    reader.version_and_flags()
    return reader.number(4), reader.number(4)


def _cropped(reader: _Reader, size: tuple[int, int]) -> tuple[int, int]:
    """The size that a clean aperture leaves; the whole size if it makes no sense."""
    width, width_per, height, height_per = (reader.number(4) for _ in range(4))
    if not (width_per and height_per and width and height):
        return size
    return min(max(width // width_per, 1), size[0]), min(max(height // height_per, 1), size[1])


def _other_coding(kind: bytes) -> Failure:
    what = "an AVIF picture" if kind == b"av01" else "a HEIF picture in another coding than HEVC"
    return Failure(
        "not_an_image", f"The file looks like {what}, which is not read.", "Send a JPEG, PNG, WebP or HEIC file."
    )
