"""A tar written and read from front to back: one member after another, flat memory, whatever stands in it.

Written as POSIX pax, so that any tar unpacks it. Read by a reader of its own, which takes what the writer makes and
nothing else: plain files, names that follow our patterns, headers of bounded size. It never makes a file.
"""

import hashlib
import tarfile
from collections.abc import Iterable, Iterator
from tarfile import BLOCKSIZE
from typing import IO

from app.operations.backup.backup_format import broken

PIECE_BYTES = 256 * 1024
MAX_PAX_BYTES = 16 * 1024  # a long name's header
CHECKSUM = slice(148, 156)  # in a header
END_OF_TAR = bytes(2 * BLOCKSIZE)


class TarWriter:
    """Members one after another. sums: `sha256  name` lines of all of them, as they are added."""

    def __init__(self, file: IO[bytes], sums: IO[bytes], mtime: int) -> None:
        self._file, self._sums, self._mtime = file, sums, mtime
        self.members = 0

    def add(self, name: str, size: int, pieces: Iterable[bytes]) -> None:
        """A member of exactly this many bytes."""
        info = tarfile.TarInfo(name)
        info.size, info.mode, info.mtime = size, 0o600, self._mtime
        self._file.write(info.tobuf(tarfile.PAX_FORMAT))
        digest, written = hashlib.sha256(), 0
        for piece in pieces:
            digest.update(piece)
            written += len(piece)
            self._file.write(piece)
        if written != size:
            raise ValueError(f"{name}: {written} bytes were written and {size} announced")
        self._file.write(bytes(-size % BLOCKSIZE))
        self.members += 1
        self._sums.write(f"{digest.hexdigest()}  {name}\n".encode())

    def add_bytes(self, name: str, content: bytes) -> None:
        """A small member."""
        self.add(name, len(content), [content])

    def close(self) -> None:
        """The end of the tar."""
        self._file.write(END_OF_TAR)


class Member:
    """A member at whose content the reader stands. offset: of its first header."""

    def __init__(self, file: IO[bytes], name: str, size: int, offset: int) -> None:
        self.name, self.size, self.offset = name, size, offset
        self._file, self._left = file, size
        self._digest = hashlib.sha256()

    def pieces(self) -> Iterator[bytes]:
        """Its content, once. Raises InvalidInputError where the file ends before it."""
        while self._left:
            piece = self._file.read(min(PIECE_BYTES, self._left))
            if not piece:
                raise broken("it ends too early")
            self._left -= len(piece)
            self._digest.update(piece)
            yield piece

    def lines(self, limit: int) -> Iterator[bytes]:
        """Its lines, once, each without its end. Raises InvalidInputError where one passes the limit, in bytes."""
        rest = b""
        for piece in self.pieces():
            *lines, rest = (rest + piece).split(b"\n")
            if any(len(line) > limit for line in (*lines, rest)):
                raise broken(f"a line of {self.name} is longer than any that is written")
            yield from lines
        if rest:
            raise broken(f"{self.name} does not end with a line")

    def content(self, limit: int) -> bytes:
        """All of it. Raises InvalidInputError where that passes the limit, in bytes."""
        if self.size > limit:
            raise broken(f"{self.name} is larger than any that is written")
        return b"".join(self.pieces())

    @property
    def sha256(self) -> str:
        """Of what was read of it."""
        return self._digest.hexdigest()

    @property
    def is_read(self) -> bool:
        """Whether the reader stands behind it."""
        return not self._left


def members(file: IO[bytes], offset: int = 0) -> Iterator[Member]:
    """The members from an offset on; read each before the next. Raises InvalidInputError (`backup_broken`).

    The tar's end is looked at, and nothing may follow it.
    """
    file.seek(offset)
    while True:
        start = file.tell()
        header = _read_exactly(file, BLOCKSIZE)
        if header == bytes(BLOCKSIZE):
            if file.read(BLOCKSIZE + 1) != bytes(BLOCKSIZE):
                raise broken("it does not end where it should")
            return
        info, told = _info(header), {}
        if info.type == tarfile.XHDTYPE:
            if info.size > MAX_PAX_BYTES:
                raise broken("a header is larger than any that is written")
            told = _pax(_read_exactly(file, info.size))
            _read_padding(file, info.size)
            info = _info(_read_exactly(file, BLOCKSIZE))
        if info.type != tarfile.REGTYPE or info.size < 0:
            raise broken("it holds something else than files")
        name, size = told.get("path", info.name), info.size
        if "size" in told:
            size = int(told["size"])
        member = Member(file, name, size, start)
        yield member
        if not member.is_read:
            raise RuntimeError(f"{name} was not read")
        _read_padding(file, size)


def _info(header: bytes) -> tarfile.TarInfo:
    """A header whose checksum is right, and written in the one way that the writer writes it."""
    try:
        info = tarfile.TarInfo.frombuf(header, "utf-8", "strict")
    except (tarfile.HeaderError, UnicodeDecodeError) as error:
        raise broken("a header is not what was written") from error
    if header[CHECKSUM] != b"%06o\0 " % info.chksum:
        raise broken("a header is not what was written")
    return info


def _pax(content: bytes) -> dict[str, str]:
    """Name and size from the records of a pax header, `length key=value`; others are not written."""
    told: dict[str, str] = {}
    while content:
        length, _, _ = content.partition(b" ")
        if not length.isdigit() or not len(length) < int(length) <= len(content):
            raise broken("a header is not what was written")
        record, content = content[: int(length)], content[int(length) :]
        key, _, value = record[len(length) + 1 :].partition(b"=")
        try:
            told[key.decode("ascii")] = value.removesuffix(b"\n").decode("utf-8")
        except UnicodeDecodeError as error:
            raise broken("a header is not what was written") from error
    if not told.keys() <= {"path", "size"} or not told.get("size", "0").isdecimal() or len(told.get("size", "")) > 18:
        raise broken("a header is not what was written")
    return told


def _read_exactly(file: IO[bytes], size: int) -> bytes:
    content = file.read(size)
    if len(content) != size:
        raise broken("it ends too early")
    return content


def _read_padding(file: IO[bytes], size: int) -> None:
    if any(_read_exactly(file, -size % BLOCKSIZE)):
        raise broken("there is something between its members")
