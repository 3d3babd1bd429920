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
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from app.core.errors import InvalidInputError
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
    "meal_image": ("blob_key", "erased_at"),
    "run": ("result_key", None),
    "run_artefact": ("blob_key", None),
    "release_file": ("blob_key", None),
}


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a backup is of. tables: name -> [column, type] of each value of a row; key_check: names the secret key."""

    format: int
    backup: str
    created_at: datetime
    program: str
    revision: str
    database: str
    key_check: str
    tables: Mapping[str, list[list[str]]]

    def to_bytes(self) -> bytes:
        """As the member."""
        return json.dumps(asdict(self) | {"created_at": self.created_at.isoformat()}, indent=1).encode()


@dataclass(frozen=True, slots=True)
class End:
    """What was written, in numbers. rows: of each table. erased: blobs that an erasure took while it was written.

    damaged: blobs that should be there and could not be copied. lacking.jsonl names both.
    """

    members: int
    sums_sha256: str
    rows: Mapping[str, int]
    blobs: int
    blob_bytes: int
    erased: int
    damaged: int

    def to_bytes(self, box: SecretBox) -> bytes:
        """As the member, sealed under the server's key: nobody else can make or change a backup unseen."""
        text = _canonical(asdict(self))
        document = {"contents": asdict(self), "sha256": _sha256(text), "seal": box.digest("backup.end", text)}
        return json.dumps(document).encode()


@dataclass(frozen=True, slots=True)
class Lacking:
    """A blob that rows name and the backup does not hold. why: ERASED, or what is wrong with it."""

    key: str
    why: str

    def to_line(self) -> bytes:
        """As a line of the member."""
        return json.dumps([self.key, self.why]).encode() + b"\n"


def chunk_name(table: str, number: int) -> str:
    """The member of a table's rows, counted from 1."""
    return f"tables/{table}/{number:06d}.jsonl.gz"


def described(layout: Iterable[TableLayout]) -> dict[str, list[list[str]]]:
    """The layout as the manifest tells it."""
    return {table.name: [[column.name, column.type] for column in table.columns] for table in layout}


def key_check(box: SecretBox, backup: str) -> str:
    """What only the same secret key makes of this backup's id."""
    return box.digest("backup.key", backup)


def read_manifest(content: bytes) -> Manifest:
    """Raises InvalidInputError: `backup_broken`, `backup_too_new`."""
    document = _document(content, MANIFEST)
    number = document.get("format")
    if isinstance(number, int) and number > FORMAT:
        raise too_new(f"its format is {number}, this program reads {FORMAT}")
    try:
        manifest = Manifest(**document | {"created_at": datetime.fromisoformat(document["created_at"])})
    except (TypeError, ValueError, KeyError) as error:
        raise broken(f"{MANIFEST} is not as it must be") from error
    texts = (manifest.backup, manifest.program, manifest.revision, manifest.database, manifest.key_check)
    if manifest.format != FORMAT or not all(isinstance(text, str) for text in texts):
        raise broken(f"{MANIFEST} is not as it must be")
    if not isinstance(manifest.tables, dict) or not all(map(_is_table, manifest.tables.values())):
        raise broken(f"{MANIFEST} is not as it must be")
    if manifest.created_at.tzinfo is None:
        raise broken(f"{MANIFEST} has a time without a zone")
    return manifest


def read_end(content: bytes, box: SecretBox | None) -> End:
    """Raises InvalidInputError (`backup_broken`). box None: it was sealed under a key that nobody has any more."""
    document = _document(content, END)
    try:
        contents = document["contents"]
        end = End(**contents)
        is_whole = document["sha256"] == _sha256(_canonical(contents)) and _is_end(end)
        is_sealed = box is None or document["seal"] == box.digest("backup.end", _canonical(contents))
    except (TypeError, KeyError, AttributeError) as error:
        raise broken(f"{END} is not as it must be") from error
    if not is_whole:
        raise broken(f"{END} is not what was written")
    if not is_sealed:
        raise broken("its seal is not of the server's secret key: it was changed after it was made")
    return end


def read_lacking(line: bytes) -> Lacking:
    """A line of the member. Raises InvalidInputError (`backup_broken`)."""
    try:
        key, why = json.loads(line)
        key.encode()
    except (AttributeError, ValueError, TypeError, RecursionError) as error:
        raise broken(f"{LACKING} holds a line that is none") from error
    if not isinstance(key, str) or not isinstance(why, str):
        raise broken(f"{LACKING} holds a line that is none")
    return Lacking(key, why)


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


def _is_table(columns: object) -> bool:
    return isinstance(columns, list) and all(
        isinstance(column, list) and len(column) == 2 and all(isinstance(word, str) for word in column)
        for column in columns
    )


def _is_end(end: End) -> bool:
    numbers = (end.members, end.blobs, end.blob_bytes, end.erased, end.damaged, *end.rows.values())
    return all(isinstance(number, int) for number in numbers) and isinstance(end.sums_sha256, str)


def _document(content: bytes, name: str) -> dict[str, Any]:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise broken(f"{name} is no JSON") from error
    if not isinstance(document, dict):
        raise broken(f"{name} is not as it must be")
    return document


def _canonical(document: Mapping[str, Any]) -> str:
    return json.dumps(document, sort_keys=True, separators=(",", ":"))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
