"""Keys, any number of them in flat memory: which are named by rows, and which of those have been seen.

Of blobs; and of erasures, `kind/digest`, as the ledger calls them. A throwaway SQLite file of its own; what is in it is
worth nothing after the process.
"""

import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NAMED, SEEN, ERASED = 0, 1, 2


class ScratchKeys:
    """A set of keys, each named, and then seen or erased. Made by `scratch_keys`."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def name(self, key: str) -> bool:
        """A row names this key. False: another did before."""
        done = self._connection.execute("INSERT OR IGNORE INTO key (key, state) VALUES (?, ?)", (key, NAMED))
        return done.rowcount == 1

    def see(self, key: str) -> bool:
        """It is there. False: nobody names it, or it was seen before."""
        return self._turn(key, SEEN)

    def see_erased(self, key: str) -> bool:
        """It is known to be erased. False: as above."""
        return self._turn(key, ERASED)

    def is_named(self, key: str) -> bool:
        """Whether a row names the key, seen or not."""
        return self._connection.execute("SELECT 1 FROM key WHERE key = ?", (key,)).fetchone() is not None

    def has_unseen(self) -> bool:
        """Whether a key is named that was not seen."""
        query = "SELECT 1 FROM key WHERE state = ? LIMIT 1"
        return self._connection.execute(query, (NAMED,)).fetchone() is not None

    def count_unseen(self) -> int:
        """How many keys are named that were not seen."""
        found: tuple[int] = self._connection.execute("SELECT count(*) FROM key WHERE state = ?", (NAMED,)).fetchone()
        return found[0]

    def erased(self) -> Iterator[str]:
        """Those that are known to be erased."""
        for (key,) in self._connection.execute("SELECT key FROM key WHERE state = ?", (ERASED,)):
            yield key

    def named(self) -> Iterator[str]:
        """All keys, in the order in which they were named."""
        for (key,) in self._connection.execute("SELECT key FROM key ORDER BY rowid"):
            yield key

    def _turn(self, key: str, state: int) -> bool:
        done = self._connection.execute("UPDATE key SET state = ? WHERE key = ? AND state = ?", (state, key, NAMED))
        return done.rowcount == 1


@contextmanager
def scratch_keys() -> Iterator[ScratchKeys]:
    """An empty set; gone at the end."""
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
