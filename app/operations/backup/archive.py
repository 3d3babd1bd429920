"""The file of a backup: a plain tar whose last member is a seal over all bytes before it.

    tada-backup.json                    the manifest
    tables/NAME/000001.parquet ...      rows, referenced tables first
    blobs/KEY ...                       photographs and the like, by their keys in the store
    lacking.jsonl                       blobs that rows name but the backup lacks, with the reason
    seal.json                           SHA-256 of all before, and its HMAC by the server's key

Nothing of a file is read before its seal is verified, but the format's number in its manifest.
"""

import hashlib
import io
import json
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import IO

from pydantic import AwareDatetime, ConfigDict

from app.core.errors import InvalidInputError
from app.db.schema_state import revisions
from app.http.closed_model import ClosedModel
from app.people.access.secret_box import KEY_FILE, SecretBox, SecretKeyError

FORMAT = 3
MANIFEST, LACKING, SEAL = "tada-backup.json", "lacking.jsonl", "seal.json"
TABLES, BLOBS = "tables/", "blobs/"
PIECE_BYTES = 256 * 1024
MAX_MANIFEST_BYTES = 1024 * 1024
TAIL_BYTES = 4 * tarfile.BLOCKSIZE  # the seal's header and content, and two blocks that end a tar
ERASED = "erased"  # reason for a blob erased while the backup was written
MAX_DAMAGED_LISTED = 1000  # damaged blobs named in results; lacking.jsonl has all
ReportProgress = Callable[[str], None]  # receives readable progress


class Manifest(ClosedModel):
    """What a backup is of.

    backup: its id
    program, revision: versions of the program and of the schema
    database: "sqlite" or "postgresql"
    """

    model_config = ConfigDict(frozen=True, strict=True)

    format: int
    backup: str
    created_at: AwareDatetime
    program: str
    revision: str
    database: str


@dataclass(slots=True)
class Backup:
    """Contents of a backup, counted while it is written or read.

    tables: name -> number of rows
    damaged_blobs: number of blobs that could not be copied
    damaged: key -> reason, of the first MAX_DAMAGED_LISTED of them
    erased: keys of blobs erased while it was written
    erasures: keys in the ledger of the erasures that its rows record; known when it is read
    """

    manifest: Manifest
    tables: dict[str, int]
    blobs: int = 0
    blob_bytes: int = 0
    damaged_blobs: int = 0
    damaged: dict[str, str] = field(default_factory=dict)
    erased: list[str] = field(default_factory=list)
    erasures: set[str] = field(default_factory=set)

    def count_blob(self, size: int) -> None:
        """Count a blob that is in the backup. size: bytes."""
        self.blobs += 1
        self.blob_bytes += size

    def count_lacking(self, key: str, reason: str) -> None:
        """Count a blob that the backup lacks. reason: ERASED, or its fault."""
        if reason == ERASED:
            self.erased.append(key)
            return
        self.damaged_blobs += 1
        if self.damaged_blobs <= MAX_DAMAGED_LISTED:
            self.damaged[key] = reason


class ArchiveWriter:
    """Writes members one after the other, then the seal."""

    def __init__(self, file: IO[bytes], mtime: int) -> None:
        self._file, self._mtime = file, mtime
        self._digest = hashlib.sha256()

    def add(self, name: str, content: IO[bytes], size: int) -> None:
        """Add a member of this many bytes."""
        info = tarfile.TarInfo(name)
        info.size, info.mode, info.mtime = size, 0o600, self._mtime
        self._write(info.tobuf(tarfile.PAX_FORMAT))
        while piece := content.read(PIECE_BYTES):
            self._write(piece)
        self._write(bytes(-size % tarfile.BLOCKSIZE))

    def add_bytes(self, name: str, content: bytes) -> None:
        """Add a member."""
        self.add(name, io.BytesIO(content), len(content))

    def seal(self, box: SecretBox) -> None:
        """End the archive by its seal: without it, it is refused."""
        sha256 = self._digest.hexdigest()
        self._file.write(_tail(sha256, _hmac(box, sha256)))

    def _write(self, content: bytes) -> None:
        self._digest.update(content)
        self._file.write(content)


def members(file: IO[bytes]) -> Iterator[tuple[str, int, IO[bytes]]]:
    """Yield name, size and content of each member but the seal, in constant memory.

    Raises InvalidInputError (`backup_broken`).
    """
    file.seek(0)
    try:
        with tarfile.open(fileobj=file, mode="r:") as tar:
            while (info := tar.next()) is not None and info.name != SEAL:
                content = tar.extractfile(info) if info.isfile() else None
                if content is None:
                    raise broken(f"{info.name} is not a file")
                yield info.name, info.size, content
                tar.members.clear()  # type: ignore[attr-defined]  # as stream=True of Python 3.13
    except tarfile.TarError as error:
        raise broken("it is not a tar") from error


def read_manifest(file: IO[bytes]) -> Manifest:
    """Read the manifest. Raises InvalidInputError if this program cannot restore such a backup.

    Codes: `backup_too_old`, `backup_too_new`, `backup_broken`.
    """
    name, _, content = next(members(file), ("", 0, io.BytesIO()))
    try:
        text = content.read(MAX_MANIFEST_BYTES)
        number, program = int(json.loads(text)["format"]), json.loads(text)["program"]
        manifest = Manifest.model_validate_json(text) if number == FORMAT else None
    except (tarfile.TarError, ValueError, KeyError, TypeError) as error:
        raise broken(f"{MANIFEST} is invalid") from error
    if name != MANIFEST:
        raise broken(f"{MANIFEST} is missing")
    if number < FORMAT:
        raise InvalidInputError(
            f"The backup was made by version {program}, in the format of before 0.5: restore it "
            "with that version, upgrade the restored deployment, then back it up anew. "
            "Nothing was restored.",
            code="backup_too_old",
        )
    if manifest is None or manifest.revision not in revisions():
        raise InvalidInputError(
            f"The backup was made by a newer program than this, version {program}. "
            "Install that version, then restore it with that.",
            code="backup_too_new",
        )
    return manifest


def verify_seal(
    file: IO[bytes],
    box: SecretBox | None,
    report: ReportProgress,
    *,
    other_key: bool,
) -> None:
    """Read the whole file and compare it with its seal. other_key: its key is lost.

    Raises InvalidInputError (`backup_broken`), SecretKeyError if another key sealed it.
    """
    size = file.seek(0, io.SEEK_END) - TAIL_BYTES
    file.seek(0)
    digest = hashlib.sha256()
    for offset in range(0, size, PIECE_BYTES):
        digest.update(file.read(min(PIECE_BYTES, size - offset)))
        report(f"checked: {offset / 1e6:.0f} MB of {size / 1e6:.0f}")
    tail = file.read(TAIL_BYTES + 1)
    try:
        document = tail[tarfile.BLOCKSIZE : 2 * tarfile.BLOCKSIZE].rstrip(b"\0")
        hmac = str(json.loads(document)["hmac"])
    except (ValueError, KeyError, TypeError) as error:
        raise broken("it ends too early") from error
    sha256 = digest.hexdigest()
    if tail != _tail(sha256, hmac):
        raise broken("it is not what was sealed")
    if not other_key and (box is None or hmac != _hmac(box, sha256)):
        raise SecretKeyError(
            "TADA_SECRET_KEY is not the key of this backup, or the backup was changed. Without the "
            "key erasures cannot be reapplied, and webhooks' secrets cannot be opened. Set it, or "
            f"put the file {KEY_FILE} of the old data folder into TADA_DATA_DIR. If it is lost: "
            "--other-key."
        )


def broken(reason: str) -> InvalidInputError:
    """Return the error for an invalid backup."""
    message = f"The backup is broken: {reason}. Nothing was restored."
    return InvalidInputError(message, code="backup_broken")


def _hmac(box: SecretBox, sha256: str) -> str:
    return box.digest("backup.seal", sha256)


def _tail(sha256: str, hmac: str) -> bytes:
    """Return the last member and the end of the tar."""
    content = json.dumps({"sha256": sha256, "hmac": hmac}).encode()
    info = tarfile.TarInfo(SEAL)
    info.size, info.mode = len(content), 0o600
    end_of_tar = bytes(2 * tarfile.BLOCKSIZE)
    return info.tobuf(tarfile.PAX_FORMAT) + content.ljust(tarfile.BLOCKSIZE, b"\0") + end_of_tar
