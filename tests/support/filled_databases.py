"""Rows of the tests' databases, written once per worker and copied: a copy of its pages is quick to make."""

import copy
import sqlite3
from collections.abc import Callable, Hashable
from typing import Any

from app.db.session import Database

_filled: dict[Hashable, tuple[sqlite3.Connection, Any]] = {}


def fill_once(database: Database, fill: Callable[[Database], Any], key: Hashable = None) -> Any:
    """Fill an empty, migrated database as `fill` does. Returns what it returned, a copy for each test.

    key: the same for all that fill alike; None: `fill` itself.

    PostgreSQL, which has no copy into an open database, is filled anew.
    """
    path = database.write_engine.url.database
    if not database.is_sqlite or path is None:
        return fill(database)
    key = key or fill
    if key not in _filled:
        returned = fill(database)
        kept = sqlite3.connect(":memory:")
        _copy(path, lambda file: file.backup(kept))
        _filled[key] = (kept, returned)
    else:
        kept, returned = _filled[key]
        _copy(path, kept.backup)
    return copy.deepcopy(returned)


def _copy(path: str, copy_to_or_from: Callable[[sqlite3.Connection], None]) -> None:
    file = sqlite3.connect(path)
    try:
        copy_to_or_from(file)
    finally:
        file.close()
