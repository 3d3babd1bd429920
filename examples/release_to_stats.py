"""A release for SPSS and Stata, with labels: `python release_to_stats.py FOLDER`, which has the release's files.

Needs `pip install pandas pyarrow pyreadstat`. Instants are UTC; a boolean is 1 or 0; a list is a text with blanks.
"""

import json
import sys
from pathlib import Path

import pandas as pd
import pyreadstat

TABLES = ("participants", "days", "meals", "items")
LONGEST_NAME, LONGEST_LABEL = 32, 80  # of Stata


def readable(values, kind):
    """A column with a type that both formats have."""
    if kind in ("instant", "local time"):
        return pd.to_datetime(values, utc=kind == "instant").dt.tz_localize(None)
    if kind in ("number", "integer", "boolean"):
        return values.astype("Float64").astype("float64")
    if kind == "words":
        values = values.map(" ".join, na_action="ignore")
    return values.astype("object").where(values.notna(), None)


def label_of(column):
    """Unit and meaning."""
    return f"[{column['unit']}] {column['meaning']}" if column["unit"] else column["meaning"]


def main(folder):
    tables = json.loads((folder / "datapackage.json").read_text(encoding="utf-8"))["tada"]["tables"]
    for table in TABLES:
        if table not in tables:  # a release of some statuses has no days
            continue
        columns = {column["name"]: column for column in tables[table]}
        frame = pd.read_parquet(folder / f"{table}.parquet")
        frame = pd.DataFrame(
            {name: readable(frame[name], column["type"]) for name, column in columns.items()}
        )
        labels = {name: label_of(column)[:LONGEST_LABEL] for name, column in columns.items()}
        pyreadstat.write_sav(frame, folder / f"{table}.sav", column_labels=labels)
        pyreadstat.write_dta(frame, folder / f"{table}.dta", column_labels=labels)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
