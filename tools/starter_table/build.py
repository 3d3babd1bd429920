"""Builds the starter food table from public releases, selection.toml (kept by hand) and ecustfd.csv.

    python -m tools.starter_table.build --sr28 PATH --fao PATH -o app/nutrition/starter/

--sr28 is the ASCII release, zip or folder; --fao the density workbook. Writes foods.json and nutrients.csv; the same
inputs give the same bytes. ecustfd.csv is written by tools/ecustfd.py.
"""

import argparse
import csv
import io
import json
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

from app.foods.importers.fao_density import read_fao_rows
from app.foods.importers.sr28 import Sr28Food, Sr28Release, parse_refuse
from app.nutrition.components import COMPONENTS
from app.nutrition.foods import FoodState, RefusePart, parse_table
from app.nutrition.usual_form import usual_state
from tools.ecustfd import read_measured
from tools.starter_table.densities import StarterSources, starter_densities
from tools.starter_table.groups import food_group, mean_contents

FOLDER = Path(__file__).parent

# The components that most studies ask for; the whole release has 150 (tada foods import sr28).
_LAST_COMPONENT = "VITK1"
_TAGNAMES = [component.tagname or "" for component in COMPONENTS]
TAGNAMES = {
    c.tagname: c.number for c in COMPONENTS[: _TAGNAMES.index(_LAST_COMPONENT) + 1] if c.tagname
}
_AS_EATEN_GROUPS = frozenset({"Baked Products", "Snacks", "Sweets", "Nut and Seed Products"})


def build(sources: StarterSources, selection: Mapping[str, Any]) -> tuple[bytes, bytes]:
    """Return foods.json and nutrients.csv of the selection's foods.

    Raises ValueError where the selection and the releases differ.
    """
    chosen = selection["food"]
    foods = {entry["key"]: _food(sources, entry) for entry in chosen}
    contents = {entry["key"]: sources.contents[entry["ndb"]] for entry in chosen}
    for entry in selection["group"]:
        foods[entry["key"]] = food_group(entry, foods, contents)
        contents[entry["key"]] = mean_contents([contents[member] for member in entry["members"]])
    lines = [json.dumps(food, ensure_ascii=False, separators=(",", ":")) for food in foods.values()]
    release = json.dumps(
        {key: str(value) for key, value in selection["release"].items()}, ensure_ascii=False
    )
    foods_json = f'{{"release":{release},\n"foods":[\n' + ",\n".join(lines) + "\n]}\n"
    return foods_json.encode(), _nutrients_csv(contents).encode()


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.starter_table.build", description="Build the food table."
    )
    parser.add_argument(
        "--sr28", type=Path, required=True, help="USDA SR28, ASCII release: zip or folder"
    )
    parser.add_argument(
        "--fao", type=Path, required=True, help="FAO/INFOODS Density Database 2.0, xlsx"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help="folder to write the table into"
    )
    options = parser.parse_args(arguments)
    selection = tomllib.loads((FOLDER / "selection.toml").read_text())
    measured = read_measured((FOLDER / "ecustfd.csv").read_text())
    sources = StarterSources(
        Sr28Release(options.sr28), read_fao_rows(options.fao), measured, selection
    )
    foods_json, nutrients_csv = build(sources, selection)
    table = parse_table(foods_json, nutrients_csv)  # raises before anything is written
    (options.output / "foods.json").write_bytes(foods_json)
    (options.output / "nutrients.csv").write_bytes(nutrients_csv)
    sys.stdout.write(
        f"{table.name} {table.version}: {len(table.foods)} foods, checksum {table.checksum[:12]}\n"
    )


def _food(sources: StarterSources, entry: Mapping[str, Any]) -> dict[str, Any]:
    source = sources.foods[entry["ndb"]]
    return {
        "key": entry["key"],
        "name": entry["name"],
        "aliases": entry.get("aliases", []),
        "food_group": sources.groups[source.group_code],
        "form": entry["form"],
        "slice_form": entry.get("slice_form"),
        "refuse": [astuple(part) for part in _refuse(source, entry)],
        "densities": [astuple(density) for density in starter_densities(sources, entry)],
        "source_ids": {
            "sr28_figures" if entry.get("stand_in") else "sr28_ndb": source.ndb_number,
            "sr28_name": source.name,
        },
        "state": _state(sources.groups[source.group_code], entry),
        "is_mixed_dish": entry.get("mixed_dish", False),
        "portions": [astuple(portion) for portion in sources.own_portions(entry)],
        "probes": entry.get("probes", []),
    }


def _state(group: str, entry: Mapping[str, Any]) -> FoodState:
    """Return the state that the entry names; "as_eaten" for dishes and for baked goods, snacks, sweets and nuts."""
    return (
        "as_eaten"
        if entry.get("mixed_dish") or group in _AS_EATEN_GROUPS
        else usual_state(entry["state"])
    )


def _refuse(source: Sr28Food, entry: Mapping[str, Any]) -> list[RefusePart]:
    served_without = entry.get("served_without", [])
    parts = parse_refuse(source.refuse_words, source.refuse_percent)
    unknown = set(served_without) - {part for part, _ in parts}
    if unknown:
        raise ValueError(f"{entry['key']}: SR28 names no part {sorted(unknown)} among {parts}")
    return [RefusePart(part, percent, part not in served_without) for part, percent in parts]


def _nutrients_csv(contents: Mapping[str, Mapping[str, float]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, ["key", *TAGNAMES], restval="", lineterminator="\n")
    writer.writeheader()
    for key, content in contents.items():
        row = {
            tagname: f"{content[number]:g}"
            for tagname, number in TAGNAMES.items()
            if number in content
        }
        writer.writerow({"key": key, **row})
    return text.getvalue()


if __name__ == "__main__":
    main()
