"""What a backup looks like inside: a tar whose members come in one order (docs/backup.md tells it to people).

    tada-backup.json                    what it is: the manifest
    tables/NAME/000001.jsonl.gz ...     rows, table by table, those that are referred to first
    blobs/KEY ...                       photographs and what runs made, under the keys of the store
    lacking.jsonl                       blobs that are not in it though rows name them, each with the reason
    SHA256SUMS                          of every member before it, as sha256sum reads it
    end.json                            counts and seals: without it the backup is not whole

This module knows names, the two documents and their seals; the tar is backup_tar.py's, values are backup_values.py's.
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
CHUNK_BYTES = 2 * 1024 * 1024  # of rows before compression: a chunk ends with the row that passes it
MAX_CHUNK_BYTES = 64 * 1024 * 1024  # one that unpacks to more was not written by us
MAX_DOCUMENT_BYTES = 1024 * 1024  # manifest and end: they grow with the number of tables and with nothing else
MAX_LACKING_BYTES = 64 * 1024  # a line of lacking.jsonl
ERASED = "erased"  # the reason of a blob that an erasure took while the backup was written
DAMAGED_TOLD = 1000  # of the blobs that it lacks: the first so many are told by name; lacking.jsonl has all
TABLE_MEMBER = re.compile(r"^tables/([a-z0-9_]{1,63})/([0-9]{6,9})\.jsonl\.gz$")
BLOBS = "blobs/"

# table -> (column of the key, column that says that the blob is deleted)
BLOB_COLUMNS = {
    mapper.class_.__tablename__: (mapper.class_.blob.key, mapper.class_.blob.erased_at)
    for mapper in Base.registry.mappers
    if mapper.class_.blob is not None
}


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class Manifest(_Document):
    """What a backup is of. tables: name -> [column, type] of each value of a row; key_check: names the secret key."""

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
    """What was written, in numbers. rows: of each table. erased: blobs that an erasure took while it was written.

    damaged: blobs that should be there and could not be copied. lacking.jsonl names both.
    """

    members: int
    sums_sha256: str
    rows: dict[str, int]
    blobs: int
    blob_bytes: int
    erased: int
    damaged: int

    def to_bytes(self, box: SecretBox) -> bytes:
        """Return the member, sealed under the server's key: nobody else can make or change a backup unseen."""
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
    """Of a manifest that a newer program may have written in another way."""

    format: int


DocumentT = TypeVar("DocumentT")
_LACKING = TypeAdapter(tuple[str, str])


@dataclass(frozen=True, slots=True)
class Backup:
    """A backup as a whole. damaged_first: key -> why, of the first DAMAGED_TOLD blobs that it lacks."""

    manifest: Manifest
    end: End
    damaged_first: Mapping[str, str]


def lacking_line(key: str, why: str) -> bytes:
    """Return the line of a blob that rows name and the backup does not hold. why: ERASED, or what is wrong with it."""
    return json.dumps([key, why]).encode() + b"\n"


def chunk_name(table: str, number: int) -> str:
    """The member of a table's rows, counted from 1."""
    return f"tables/{table}/{number:06d}.jsonl.gz"


def described(layout: Iterable[TableLayout]) -> dict[str, list[tuple[str, str]]]:
    """Return the layout as the manifest has it."""
    return {table.name: [(column.name, column.type) for column in table.columns] for table in layout}


def key_check(box: SecretBox, backup: str) -> str:
    """Return what only the same secret key makes of this backup's id."""
    return box.digest("backup.key", backup)


def read_manifest(content: bytes) -> Manifest:
    """Raises InvalidInputError: `backup_broken`, `backup_too_new`."""
    number = _read(TypeAdapter(_Format), content, MANIFEST).format
    if number > FORMAT:
        raise too_new(f"its format is {number}, this program reads {FORMAT}")
    manifest = _read(TypeAdapter(Manifest), content, MANIFEST)
    if manifest.format != FORMAT:
        raise _not_as_it_must_be(MANIFEST)
    return manifest


def read_end(content: bytes, box: SecretBox | None) -> End:
    """Raises InvalidInputError (`backup_broken`). box None: it was sealed under a key that nobody has any more."""
    sealed = _read(TypeAdapter(_SealedEnd), content, END)
    text = sealed.contents.canonical()
    if sealed.sha256 != _sha256(text):
        raise broken(f"{END} is not what was written")
    if box is not None and sealed.seal != box.digest("backup.end", text):
        raise broken("its seal is not of the server's secret key: it was changed after it was made")
    return sealed.contents


def read_lacking(line: bytes) -> tuple[str, str]:
    """The key and why it is lacking, of a line. Raises InvalidInputError (`backup_broken`)."""
    try:
        return _LACKING.validate_json(line, strict=True)
    except ValidationError as error:
        raise broken(f"{LACKING} holds a line that is none") from error


def broken(why: str) -> InvalidInputError:
    """The backup is not what was written."""
    return InvalidInputError(f"The backup is broken: {why}. Nothing was restored.", code="backup_broken")


def too_new(why: str) -> InvalidInputError:
    """The backup is of a newer program."""
    return InvalidInputError(
        f"The backup was made by a newer program than this: {why}. Install that version, then restore.",
        code="backup_too_new",
    )


def too_old(why: str) -> InvalidInputError:
    """The backup names the schema of a version before 0.4; the rest of it has not been read."""
    return InvalidInputError(
        f"The backup was made by a version before 0.4: {why}. Only that version can restore it. Nothing was restored.",
        code="backup_too_old",
    )


def _read(document: TypeAdapter[DocumentT], content: bytes, name: str) -> DocumentT:
    try:
        return document.validate_json(content, strict=True)
    except ValidationError as error:
        raise _not_as_it_must_be(name) from error


def _not_as_it_must_be(name: str) -> InvalidInputError:
    return broken(f"{name} is not as it must be")


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
