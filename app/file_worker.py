"""Runs one task on the live tables and ends: `python -m app.file_worker`, by exports/file_task.py.

The task stands on standard input as JSON, its answer on standard output. This process never opens
the database but by DuckDB.
"""

import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import duckdb

from app.core.process_life import die_with_parent, keep_files_private
from app.exports.export_table import export_table
from app.exports.live_tables import live_tables
from app.exports.releases.freeze_release import freeze_tables

Task = Callable[[duckdb.DuckDBPyConnection, Mapping[str, Any]], dict[str, Any]]
TASKS: Mapping[str, Task] = {"export": export_table, "freeze": freeze_tables}
QUOTED = re.compile(r"""'[^']*'|"[^"]*\"""")
NO_SPACE = "No space left on device"


def main() -> None:
    """Run the task that standard input tells."""
    keep_files_private()
    message = json.load(sys.stdin)
    die_with_parent(message["parent"])
    os.nice(message["niceness"])
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    json.dump(answer_to(message), answers)
    answers.flush()


def answer_to(message: Mapping[str, Any]) -> dict[str, Any]:
    """The task's result, or the kind of its error and a message for the log."""
    try:
        with live_tables(message["database_url"], Path(message["folder"])) as connection:
            return {"result": TASKS[message["task"]](connection, message["request"])}
    except (duckdb.Error, OSError) as error:
        return {"error": {"kind": _kind_of(error), "message": without_values(error)}}


def without_values(error: Exception) -> str:
    """An error's kind and first line, without what it quotes: values are personal."""
    first_line = str(error).partition("\n")[0]
    return f"{type(error).__name__}: {QUOTED.sub('...', first_line)}"


def _kind_of(error: Exception) -> str:
    if NO_SPACE in str(error):
        return "full"
    return "unavailable" if isinstance(error, duckdb.IOException) else "defect"


if __name__ == "__main__":
    main()
