"""Verify a backup completely before anything is restored from it.

Checks every checksum, every row against the tables of its revision, every blob against the SHA-256 in its key and the
rows that name it. Anything invalid is refused (`backup_broken` and the like), so a restore only handles valid values.
Memory use is bounded whatever the file contains.
"""

import hashlib
import io
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import IO

from app.db.layout import TableLayout, layout_at
from app.db.schema_state import is_before_baseline, revisions
from app.db.scratch_keys import ScratchKeys, scratch_keys
from app.operations.backup.backup import ReportProgress, blob_namer
from app.operations.backup.backup_blobs import is_blob_key, sha256_of_key
from app.operations.backup.backup_format import (
    BLOBS,
    END,
    ERASED,
    LACKING,
    MANIFEST,
    MAX_CHUNK_BYTES,
    MAX_DAMAGED_LISTED,
    MAX_DOCUMENT_BYTES,
    MAX_LACKING_BYTES,
    SUMS,
    TABLE_MEMBER,
    Backup,
    End,
    Manifest,
    broken,
    chunk_name,
    manifest_tables,
    read_end,
    read_lacking,
    read_manifest,
    too_new,
    too_old,
)
from app.operations.backup.backup_tar import Member, members
from app.operations.backup.backup_values import row_reader
from app.people.access.secret_box import SecretBox
from app.privacy.erasure_ledger import KINDS

GZIP_WINDOW = 31  # zlib's number for gzip's own header and check
OpenBox = Callable[[Manifest], SecretBox | None]  # returns the key to verify the seal with; raises for a different key


@dataclass(frozen=True, slots=True)
class CheckedBackup(Backup):
    """A verified backup. chunks: table -> SHA-256 of each chunk of its rows. blobs_offset: of the first blob."""

    layout: tuple[TableLayout, ...]
    chunks: Mapping[str, list[str]]
    blobs_offset: int


@dataclass(frozen=True, slots=True)
class Named:
    """Keys that the rows of a backup name. blobs: keys of blobs; erasures: of tombstones, as in the ledger."""

    blobs: ScratchKeys
    erasures: ScratchKeys


@contextmanager
def empty_named() -> Iterator[Named]:
    """Yield an empty set of keys for check_backup; removed at the end."""
    with scratch_keys() as blobs, scratch_keys() as erasures:
        yield Named(blobs, erasures)


def check_backup(file: IO[bytes], open_box: OpenBox, named: Named, report_progress: ReportProgress) -> CheckedBackup:
    """Read and verify a backup. named: receives the keys that its rows name.

    Raises InvalidInputError (`backup_broken`, `backup_too_new`, `backup_too_old`), and what open_box raises.
    """
    reading = _Reading(file, named, report_progress)
    manifest = reading.manifest()
    box = open_box(manifest)
    layout = _layout_of(manifest)
    rows, chunks = {}, {}
    for table in layout:
        rows[table.name], chunks[table.name] = reading.table(table)
    blobs_offset = reading.offset
    blobs, blob_bytes = reading.blobs()
    erased, damaged, damaged_first = reading.lacking()
    end = reading.end(box)
    if (end.rows, end.blobs, end.blob_bytes, end.erased, end.damaged) != (rows, blobs, blob_bytes, erased, damaged):
        raise broken("its counts differ from those at its end")
    if named.blobs.has_unseen():
        raise broken("its rows name blobs that are not in it")
    return CheckedBackup(manifest, end, damaged_first, layout, chunks, blobs_offset)


def erasure_namer(table: TableLayout, erasures: ScratchKeys) -> Callable[[Sequence[object]], None]:
    """Return a function that adds the erasure recorded by a row of this table, if the ledger has such entries."""
    if table.name != "tombstone":
        return lambda _row: None
    places = [place for column in ("kind", "digest") if (place := table.place(column)) is not None]

    def name(row: Sequence[object]) -> None:
        kind, digest = (row[place] for place in places)
        if kind in KINDS:
            erasures.name(f"{kind}/{digest}")

    return name


def unpacked_rows(content: bytes, name: str, read: Callable[[bytes], list[object]]) -> Iterator[list[object]]:
    """Yield the rows of a chunk. Raises InvalidInputError (`backup_broken`)."""
    unpacker = zlib.decompressobj(GZIP_WINDOW)
    try:
        text = unpacker.decompress(content, MAX_CHUNK_BYTES)
    except zlib.error as error:
        raise broken(f"{name} cannot be unpacked") from error
    if unpacker.unconsumed_tail or not unpacker.eof or unpacker.unused_data or not text.endswith(b"\n"):
        raise broken(f"{name} does not unpack to what was packed")
    for line in io.BytesIO(text):
        try:
            yield read(line)
        except ValueError as error:
            raise broken(f"{name} has an invalid row: {error}") from error


class _Reading:
    """Reads the members in order, each exactly once, with a look-ahead of one."""

    def __init__(self, file: IO[bytes], named: Named, report_progress: ReportProgress) -> None:
        self._members = members(file)
        self._named, self._report_progress = named, report_progress
        self._sums, self._count = hashlib.sha256(), 0
        self._next = self._advance()

    @property
    def offset(self) -> int:
        """Return the offset of the next member."""
        return self._current().offset

    def manifest(self) -> Manifest:
        return read_manifest(self._content(MANIFEST, MAX_DOCUMENT_BYTES))

    def table(self, table: TableLayout) -> tuple[int, list[str]]:
        """Read a table; return the number of its rows and the chunks' checksums."""
        read, count = row_reader(table), 0
        name_blob, name_erasure = blob_namer(table, self._named.blobs), erasure_namer(table, self._named.erasures)
        sums: list[str] = []
        while (match := TABLE_MEMBER.match(self._current().name)) and match[1] == table.name:
            name = chunk_name(table.name, len(sums) + 1)
            member = self._current()
            for row in unpacked_rows(self._content(name, MAX_CHUNK_BYTES), name, read):
                name_blob(row)
                name_erasure(row)
                count += 1
            sums.append(member.sha256)
            self._report_progress(f"checked: {table.name}, {count} rows")
        return count, sums

    def blobs(self) -> tuple[int, int]:
        """Read all blobs; return their number and total size in bytes."""
        count = size = 0
        while self._current().name.startswith(BLOBS):
            member = self._current()
            key = member.name.removeprefix(BLOBS)
            if not is_blob_key(key) or not self._named.blobs.see(key):
                raise broken("it has a blob that none of its rows names")
            for _ in member.pieces():
                pass
            if member.sha256 != sha256_of_key(key):
                raise broken(f"blob {key} has been changed")
            count += 1
            size += member.size
            self._done(member)
            self._report_progress(f"checked: {count} blobs, {size / 1e6:.0f} MB")
        return count, size

    def lacking(self) -> tuple[int, int, dict[str, str]]:
        """Read the list of missing blobs; return the numbers of erased and damaged ones, and the first damaged ones."""
        member, erased, damaged = self._current(), 0, 0
        first: dict[str, str] = {}
        if member.name != LACKING:
            raise broken(f"{LACKING} is not where it should be")
        for line in member.lines(MAX_LACKING_BYTES):
            key, reason = read_lacking(line)
            mark_seen = self._named.blobs.see_erased if reason == ERASED else self._named.blobs.see
            if not mark_seen(key):
                raise broken("it lists a blob as missing that it has, or that none of its rows names")
            if reason == ERASED:
                erased += 1
                continue
            damaged += 1
            if len(first) < MAX_DAMAGED_LISTED:
                first[key] = reason
        self._done(member)
        return erased, damaged, first

    def end(self, box: SecretBox | None) -> End:
        expected, count = self._sums.hexdigest(), self._count
        member = self._current()
        if member.name != SUMS:
            raise broken(f"{SUMS} is not where it should be")
        for _ in member.pieces():
            pass
        if member.sha256 != expected:
            raise broken("a checksum is wrong")
        self._done(member)
        end = read_end(self._content(END, MAX_DOCUMENT_BYTES), box)
        if (end.members, end.sums_sha256) != (count, expected):
            raise broken("a checksum is wrong")
        if self._next is not None:
            raise broken("there is data after its end")
        return end

    def _current(self) -> Member:
        if self._next is None:
            raise broken("it ends too early")
        return self._next

    def _content(self, name: str, limit: int) -> bytes:
        member = self._current()
        if member.name != name:
            raise broken(f"{name} is not where it should be")
        content = member.content(limit)
        self._done(member)
        return content

    def _done(self, member: Member) -> None:
        self._sums.update(f"{member.sha256}  {member.name}\n".encode())
        self._count += 1
        self._next = self._advance()

    def _advance(self) -> Member | None:
        return next(self._members, None)


def _layout_of(manifest: Manifest) -> tuple[TableLayout, ...]:
    """Return the tables of the backup's revision, in the manifest's order; they must match the manifest."""
    if is_before_baseline(manifest.revision):
        raise too_old(f"its schema is {manifest.revision!r}")
    if manifest.revision not in revisions():
        raise too_new(f"its schema is {manifest.revision!r}")
    tables = {table.name: table for table in layout_at(manifest.revision)}
    listed = manifest.tables
    if tables.keys() != listed.keys() or any(
        sorted(manifest_tables([tables[name]])[name]) != sorted(listed[name]) for name in listed
    ):
        raise broken("its tables are not those of its revision")
    columns = {name: {column.name: column for column in table.columns} for name, table in tables.items()}
    return tuple(
        replace(tables[name], columns=tuple(columns[name][column] for column, _ in listed[name])) for name in listed
    )
