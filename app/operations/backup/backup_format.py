"""The format of a backup: a tar with its members in a fixed order (manifest_tables for users in docs/backup.md).

    tada-backup.json                    the manifest
    tables/NAME/000001.jsonl.gz ...     rows, table by table, referenced tables first
    blobs/KEY ...                       photographs and artefacts of runs, by their keys in the store
    lacking.jsonl                       blobs that rows name but the backup lacks, each with the reason
    SHA256SUMS                          of every member before it, in the format of sha256sum
    end.json                            counts and seal: a backup without it is incomplete

This module defines names, the two documents and the seal; backup_tar.py the tar, backup_values.py the values.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from pydantic import AwareDatetime, BaseModel, ConfigDict, TypeAdapter, ValidationError

import app.tables  # noqa: F401  # defines every table
from app.core.errors import InvalidInputError
from app.db.base import Base
from app.db.layout import TableLayout
from app.people.access.secret_box import SecretBox

FORMAT = 2
MANIFEST, LACKING, SUMS, END = "tada-backup.json", "lacking.jsonl", "SHA256SUMS", "end.json"
CHUNK_BYTES = 2 * 1024 * 1024  # of rows before compression: a chunk ends with the row that exceeds it
MAX_CHUNK_BYTES = 64 * 1024 * 1024  # of an unpacked chunk; larger ones are invalid
MAX_DOCUMENT_BYTES = 1024 * 1024  # of manifest and end, whose size depends only on the number of tables
MAX_LACKING_BYTES = 64 * 1024  # a line of lacking.jsonl
ERASED = "erased"  # reason for a blob erased while the backup was written
MAX_DAMAGED_LISTED = 1000  # damaged blobs listed by name in results; lacking.jsonl has all
TABLE_MEMBER = re.compile(r"^tables/([a-z0-9_]{1,63})/([0-9]{6,9})\.jsonl\.gz$")
BLOBS = "blobs/"

# table -> (column of the key, column that marks the blob as deleted)
BLOB_COLUMNS = {
    mapper.class_.__tablename__: (mapper.class_.blob.key, mapper.class_.blob.erased_at)
    for mapper in Base.registry.mappers
    if mapper.class_.blob is not None
}


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class Manifest(_Document):
    """The manifest. tables: name -> [column, type] of each value of a row; key_check: identifies the secret key."""

    format: int
    backup: str
    created_at: AwareDatetime
    program: str
    revision: str
    database: str
    key_check: str
    tables: dict[str, list[tuple[str, str]]]

    def to_bytes(self) -> bytes:
        """Return the member."""
        return self.model_dump_json(indent=1).encode()


class End(_Document):
    """Counts of what was written. rows: per table. erased: blobs erased while the backup was written.

    damaged: blobs that could not be copied. lacking.jsonl lists both.
    """

    members: int
    sums_sha256: str
    rows: dict[str, int]
    blobs: int
    blob_bytes: int
    erased: int
    damaged: int

    def to_bytes(self, box: SecretBox) -> bytes:
        """Return the member, sealed with the server's key, so that forged or changed backups are detected."""
        text = self.canonical()
        document = _SealedEnd(contents=self, sha256=_sha256(text), seal=box.digest("backup.end", text))
        return document.model_dump_json().encode()

    def canonical(self) -> str:
        """Return the text that is sealed."""
        return json.dumps(self.model_dump(), sort_keys=True, separators=(",", ":"))


class _SealedEnd(_Document):
    contents: End
    sha256: str
    seal: str


class _Format(BaseModel):
    """The format number of a manifest, which a newer program may have written differently."""

    format: int


DocumentT = TypeVar("DocumentT")
_LACKING = TypeAdapter(tuple[str, str])


@dataclass(frozen=True, slots=True)
class Backup:
    """Summary of a backup. damaged_first: key -> reason, of the first MAX_DAMAGED_LISTED damaged blobs."""

    manifest: Manifest
    end: End
    damaged_first: Mapping[str, str]


def lacking_line(key: str, reason: str) -> bytes:
    """Return the line of a blob that the backup lacks. reason: ERASED, or its fault."""
    return json.dumps([key, reason]).encode() + b"\n"


def chunk_name(table: str, number: int) -> str:
    """Return the name of a chunk of a table's rows, counted from 1."""
    return f"tables/{table}/{number:06d}.jsonl.gz"


def manifest_tables(layout: Iterable[TableLayout]) -> dict[str, list[tuple[str, str]]]:
    """Return the layout in the manifest's form."""
    return {table.name: [(column.name, column.type) for column in table.columns] for table in layout}


def key_check(box: SecretBox, backup: str) -> str:
    """Return a digest of this backup's id with the secret key, which identifies the key."""
    return box.digest("backup.key", backup)


def read_manifest(content: bytes) -> Manifest:
    """Parse the manifest. Raises InvalidInputError: `backup_broken`, `backup_too_new`."""
    number = _read(TypeAdapter(_Format), content, MANIFEST).format
    if number > FORMAT:
        raise too_new(f"its format is {number}, this program reads {FORMAT}")
    manifest = _read(TypeAdapter(Manifest), content, MANIFEST)
    if manifest.format != FORMAT:
        raise _invalid_document(MANIFEST)
    return manifest


def read_end(content: bytes, box: SecretBox | None) -> End:
    """Parse and verify the end. Raises InvalidInputError (`backup_broken`). box None: its key is lost."""
    sealed = _read(TypeAdapter(_SealedEnd), content, END)
    text = sealed.contents.canonical()
    if sealed.sha256 != _sha256(text):
        raise broken(f"{END} has been changed")
    if box is not None and sealed.seal != box.digest("backup.end", text):
        raise broken("its seal does not match the server's secret key: it has been changed")
    return sealed.contents


def read_lacking(line: bytes) -> tuple[str, str]:
    """Return key and reason of a line of lacking.jsonl. Raises InvalidInputError (`backup_broken`)."""
    try:
        return _LACKING.validate_json(line, strict=True)
    except ValidationError as error:
        raise broken(f"{LACKING} has an invalid line") from error


def broken(reason: str) -> InvalidInputError:
    """Return the error for an invalid backup."""
    return InvalidInputError(f"The backup is broken: {reason}. Nothing was restored.", code="backup_broken")


def too_new(reason: str) -> InvalidInputError:
    """Return the error for a backup of a newer program."""
    return InvalidInputError(
        f"The backup was made by a newer program than this: {reason}. Install that version, then restore.",
        code="backup_too_new",
    )


def too_old(reason: str) -> InvalidInputError:
    """Return the error for a backup of a version before 0.4; only its manifest has been read."""
    return InvalidInputError(
        f"The backup was made by a version before 0.4: {reason}. Only that version can restore it. "
        "Nothing was restored.",
        code="backup_too_old",
    )


def _read(document: TypeAdapter[DocumentT], content: bytes, name: str) -> DocumentT:
    try:
        return document.validate_json(content, strict=True)
    except ValidationError as error:
        raise _invalid_document(name) from error


def _invalid_document(name: str) -> InvalidInputError:
    return broken(f"{name} is invalid")


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
