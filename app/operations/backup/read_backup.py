"""Verify a backup before anything is restored: first its seal, then what its members are.

The seal is over every byte, so below it is what `tada backup` wrote.
"""

import json
import re
from typing import IO

import sqlalchemy as sa

from app.core.settings import Settings
from app.operations.backup.archive import (
    BLOBS,
    LACKING,
    MANIFEST,
    Backup,
    ReportProgress,
    broken,
    members,
    read_manifest,
    verify_seal,
)
from app.operations.backup.blob_files import is_blob_key
from app.operations.backup.table_files import read_file, tables_at
from app.people.access.secret_box import existing_secret_box
from app.privacy.erasure_ledger import KINDS

TABLE_FILE = re.compile(r"^tables/([a-z0-9_]+)/[0-9]{6,}\.parquet$")


def check_backup(
    file: IO[bytes],
    settings: Settings,
    report: ReportProgress,
    *,
    other_key: bool = False,
) -> Backup:
    """Read and verify a backup. other_key: its key is lost.

    Raises InvalidInputError (`backup_broken`, `backup_too_new`, `backup_too_old`), SecretKeyError.
    """
    manifest = read_manifest(file)
    verify_seal(file, existing_secret_box(settings), report, other_key=other_key)
    backup = Backup(manifest, dict.fromkeys(tables_at(manifest.revision), 0))
    for name, size, content in members(file):
        table = table_of(name, backup)
        if table is not None:
            _check_table(backup, name, table, content.read())
        elif name.startswith(BLOBS):
            if not is_blob_key(name.removeprefix(BLOBS)):
                raise broken(f"{name} is not a blob")
            backup.count_blob(size)
        elif name == LACKING:
            _check_lacking(backup, content)
        elif name != MANIFEST:
            raise broken(f"{name} does not belong to it")
    return backup


def table_of(name: str, backup: Backup) -> sa.Table | None:
    """Return the table whose rows a member has; None: it has none."""
    match = TABLE_FILE.match(name)
    if match is None:
        return None
    table = tables_at(backup.manifest.revision).get(match[1])
    if table is None:
        raise broken(f"its schema has no table {match[1]}")
    return table


def _check_table(backup: Backup, name: str, table: sa.Table, content: bytes) -> None:
    try:
        for rows in read_file(content, table):
            backup.tables[table.name] += rows.num_rows
            if table.name == "tombstone":
                for row in rows.select(["kind", "digest"]).to_pylist():
                    if row["kind"] in KINDS:
                        backup.erasures.add(f"{row['kind']}/{row['digest']}")
    except ValueError as error:
        raise broken(f"{name}: {error}") from error


def _check_lacking(backup: Backup, content: IO[bytes]) -> None:
    for line in content:
        try:
            key, reason = map(str, json.loads(line))
        except (ValueError, TypeError) as error:
            raise broken(f"{LACKING} has an invalid line") from error
        backup.count_lacking(key, reason)
