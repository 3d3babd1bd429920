"""A set of any number of keys in constant memory: which keys rows name, and which of those have been seen.

Used for keys of blobs, and of erasures (`kind/digest` as in the ledger). Stored in a temporary SQLite file.
"""

import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NAMED, SEEN, ERASED = 0, 1, 2


class ScratchKeys:
    """A set of keys, each named, then seen or erased. Created by `scratch_keys`."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def name(self, key: str) -> bool:
        """Add a key that a row names. Returns False if another row named it before."""
        cursor = self._connection.execute("INSERT OR IGNORE INTO key (key, state) VALUES (?, ?)", (key, NAMED))
        return cursor.rowcount == 1

    def see(self, key: str) -> bool:
        """Mark a key as seen. Returns False if no row names it or it was seen before."""
        return self._set_state(key, SEEN)

    def see_erased(self, key: str) -> bool:
        """Mark a key as erased. Returns False as `see` does."""
        return self._set_state(key, ERASED)

    def is_named(self, key: str) -> bool:
        """Return whether a row names the key, seen or not."""
        return self._connection.execute("SELECT 1 FROM key WHERE key = ?", (key,)).fetchone() is not None

    def has_unseen(self) -> bool:
        """Return whether a named key has not been seen."""
        query = "SELECT 1 FROM key WHERE state = ? LIMIT 1"
        return self._connection.execute(query, (NAMED,)).fetchone() is not None

    def count_unseen(self) -> int:
        """Return how many named keys have not been seen."""
        row: tuple[int] = self._connection.execute("SELECT count(*) FROM key WHERE state = ?", (NAMED,)).fetchone()
        return row[0]

    def erased(self) -> Iterator[str]:
        """Yield the keys marked as erased."""
        for (key,) in self._connection.execute("SELECT key FROM key WHERE state = ?", (ERASED,)):
            yield key

    def named(self) -> Iterator[str]:
        """Yield all keys in the order in which they were named."""
        for (key,) in self._connection.execute("SELECT key FROM key ORDER BY rowid"):
            yield key

    def _set_state(self, key: str, state: int) -> bool:
        cursor = self._connection.execute("UPDATE key SET state = ? WHERE key = ? AND state = ?", (state, key, NAMED))
        return cursor.rowcount == 1


@contextmanager
def scratch_keys() -> Iterator[ScratchKeys]:
    """Yield an empty set, which is removed at the end."""
    with tempfile.TemporaryDirectory(prefix="tada-keys-") as folder:
        connection = sqlite3.connect(Path(folder) / "keys.sqlite3", isolation_level=None)
        try:
            connection.execute("PRAGMA journal_mode = OFF")
            connection.execute("PRAGMA synchronous = OFF")
            connection.execute("CREATE TABLE key (key TEXT NOT NULL UNIQUE, state INTEGER NOT NULL)")
            connection.execute("BEGIN")
            yield ScratchKeys(connection)
        finally:
            connection.close()
