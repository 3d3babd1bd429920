"""Write and read a tar sequentially, member after member, with bounded memory.

Written as POSIX pax, so that any tar program unpacks it. The reader accepts only what the writer produces: plain files,
names of our patterns, headers of bounded size. It never creates a file.
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
    """Writes members sequentially. sums: file for the `sha256  name` line of each member."""

    def __init__(self, file: IO[bytes], sums: IO[bytes], mtime: int) -> None:
        self._file, self._sums, self._mtime = file, sums, mtime
        self.members = 0

    def add(self, name: str, size: int, pieces: Iterable[bytes]) -> None:
        """Add a member of exactly this many bytes."""
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
        """Add a small member."""
        self.add(name, len(content), [content])

    def close(self) -> None:
        """Write the end of the tar."""
        self._file.write(END_OF_TAR)


class Member:
    """A member whose content is read next. offset: of its first header."""

    def __init__(self, file: IO[bytes], name: str, size: int, offset: int) -> None:
        self.name, self.size, self.offset = name, size, offset
        self._file, self._remaining = file, size
        self._digest = hashlib.sha256()

    def pieces(self) -> Iterator[bytes]:
        """Yield its content, once. Raises InvalidInputError if the file ends too early."""
        while self._remaining:
            piece = self._file.read(min(PIECE_BYTES, self._remaining))
            if not piece:
                raise broken("it ends too early")
            self._remaining -= len(piece)
            self._digest.update(piece)
            yield piece

    def lines(self, limit: int) -> Iterator[bytes]:
        """Yield its lines, once, without line ends. Raises InvalidInputError if one exceeds the limit, in bytes."""
        incomplete = b""
        for piece in self.pieces():
            *lines, incomplete = (incomplete + piece).split(b"\n")
            if any(len(line) > limit for line in (*lines, incomplete)):
                raise broken(f"a line of {self.name} is longer than any that is written")
            yield from lines
        if incomplete:
            raise broken(f"{self.name} does not end with a line")

    def content(self, limit: int) -> bytes:
        """Return its content. Raises InvalidInputError if it exceeds the limit, in bytes."""
        if self.size > limit:
            raise broken(f"{self.name} is larger than any that is written")
        return b"".join(self.pieces())

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of the content read so far."""
        return self._digest.hexdigest()

    @property
    def is_read(self) -> bool:
        """Return whether all of it has been read."""
        return not self._remaining


def members(file: IO[bytes], offset: int = 0) -> Iterator[Member]:
    """Yield the members from an offset on; read each before the next. Raises InvalidInputError (`backup_broken`).

    The tar must have its end mark, and nothing may follow it.
    """
    file.seek(offset)
    while True:
        start = file.tell()
        header = _read_exactly(file, BLOCKSIZE)
        if header == bytes(BLOCKSIZE):
            if file.read(BLOCKSIZE + 1) != bytes(BLOCKSIZE):
                raise broken("it does not end where it should")
            return
        info, pax_fields = _info(header), {}
        if info.type == tarfile.XHDTYPE:
            if info.size > MAX_PAX_BYTES:
                raise broken("a header is larger than any that is written")
            pax_fields = _pax(_read_exactly(file, info.size))
            _read_padding(file, info.size)
            info = _info(_read_exactly(file, BLOCKSIZE))
        if info.type != tarfile.REGTYPE or info.size < 0:
            raise broken("it has members that are not files")
        name, size = pax_fields.get("path", info.name), info.size
        if "size" in pax_fields:
            size = int(pax_fields["size"])
        member = Member(file, name, size, start)
        yield member
        if not member.is_read:
            raise RuntimeError(f"{name} was not read")
        _read_padding(file, size)


def _info(header: bytes) -> tarfile.TarInfo:
    """Parse a header; its checksum must be right and in the writer's format."""
    try:
        info = tarfile.TarInfo.frombuf(header, "utf-8", "strict")
    except (tarfile.HeaderError, UnicodeDecodeError) as error:
        raise broken("a header is invalid") from error
    if header[CHECKSUM] != b"%06o\0 " % info.chksum:
        raise broken("a header is invalid")
    return info


def _pax(content: bytes) -> dict[str, str]:
    """Return path and size from the records of a pax header, `length key=value`; other keys are invalid."""
    fields: dict[str, str] = {}
    while content:
        length, _, _ = content.partition(b" ")
        if not length.isdigit() or not len(length) < int(length) <= len(content):
            raise broken("a header is invalid")
        record, content = content[: int(length)], content[int(length) :]
        key, _, value = record[len(length) + 1 :].partition(b"=")
        try:
            fields[key.decode("ascii")] = value.removesuffix(b"\n").decode("utf-8")
        except UnicodeDecodeError as error:
            raise broken("a header is invalid") from error
    if (
        not fields.keys() <= {"path", "size"}
        or not fields.get("size", "0").isdecimal()
        or len(fields.get("size", "")) > 18
    ):
        raise broken("a header is invalid")
    return fields


def _read_exactly(file: IO[bytes], size: int) -> bytes:
    content = file.read(size)
    if len(content) != size:
        raise broken("it ends too early")
    return content


def _read_padding(file: IO[bytes], size: int) -> None:
    if any(_read_exactly(file, -size % BLOCKSIZE)):
        raise broken("there is data between its members")
