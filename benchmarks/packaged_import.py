"""How long `tada foods import off` takes for a dump of Open Food Facts' size, and how much memory.

    python benchmarks/packaged_import.py [--rows 3000000] [--keep FOLDER]

The dump is generated: a header of 200 columns as the published one has, most of them empty, and
rows of which a part has each of the faults that the import refuses. The import is the command
itself, in a process of its own, into a fresh SQLite database.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import duckdb

from benchmarks.food_import import PEAK

ROWS = 3_000_000
# column -> SQL of row i; a row in 50 has one of the faults
COLUMNS = {
    "code": "(body || (10 - checksum % 10) % 10)",
    "last_modified_t": "1600000000 + i % 90000000",
    "product_name": "'Product ' || i || ' of a factory'",
    "brands": "'Brand ' || i % 20000",
    "quantity": "(50 + i % 900) || if(i % 5 = 0, ' ml', ' g')",
    "serving_size": "'30 g'",
    "serving_quantity": "30",
    "countries_tags": "if(i % 3 = 0, 'en:united-states', 'en:france,en:germany')",
    "energy-kcal_100g": "round(kcal * CASE i % 50 WHEN 0 THEN 4.184 WHEN 1 THEN -1 ELSE 1 END, 1)",
    "energy_100g": "round(kcal * 4.184 * CASE i % 50 WHEN 0 THEN 4.184 WHEN 1 THEN -1 ELSE 1 END, 1)",
    "fat_100g": "if(i % 50 = 2, 140, fat)",
    "saturated-fat_100g": "if(i % 50 = 3, fat + 5, fat / 3)",
    "carbohydrates_100g": "carbohydrate",
    "sugars_100g": "carbohydrate / 2",
    "fiber_100g": "if(i % 2 = 0, 2.5, NULL)",
    "proteins_100g": "protein",
    "salt_100g": "0.5",
    "sodium_100g": "0.2",
}
GENERATE = """
    COPY (
        WITH row AS (
            SELECT
                i, (200000000000 + i)::VARCHAR AS body, (i * 7919) % 300 / 10.0 AS fat,
                (i * 104729) % 400 / 10.0 AS carbohydrate, (i * 31) % 250 / 10.0 AS protein,
                9 * fat + 4 * carbohydrate + 4 * protein AS kcal,
                list_sum([substr(body, k, 1)::INT * if(k % 2 = 0, 3, 1) FOR k IN range(1, 13)]) AS checksum
            FROM range({rows}) AS numbers(i)
        )
        SELECT {columns} FROM row
    ) TO '{path}' (FORMAT csv, DELIMITER '\t', HEADER, QUOTE '', ESCAPE '')
"""


def generate(path: Path, rows: int) -> None:
    """Write a dump."""
    columns = [f'{sql} AS "{name}"' for name, sql in COLUMNS.items()]
    columns += [f"NULL AS other_{number}_100g" for number in range(200 - len(columns))]
    with duckdb.connect() as connection:
        connection.execute(GENERATE.format(rows=rows, columns=", ".join(columns), path=path))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, default=ROWS)
    rows = parser.parse_args().rows
    with tempfile.TemporaryDirectory() as folder:
        dump = Path(folder) / "en.openfoodfacts.org.products.csv"
        generate(dump, rows)
        print(f"{rows} rows, {dump.stat().st_size / 1e9:.2f} GB", flush=True)
        environment = os.environ | {"TADA_DATA_DIR": folder}
        tada = [sys.executable, "-m", "app.cli"]
        subprocess.run([*tada, "db", "upgrade"], env=environment, check=True)
        begun = time.monotonic()
        command = [sys.executable, "-c", PEAK, "foods", "import", "off", str(dump)]
        subprocess.run(command, env=environment, check=True)
        print(f"{time.monotonic() - begun:.0f} s; peak_kb above is of memory")


if __name__ == "__main__":
    main()
