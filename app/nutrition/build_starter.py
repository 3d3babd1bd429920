"""Builds the starter food table from public releases and the hand-kept starter/selection.toml.

    python -m app.nutrition.build_starter --sr28 PATH --fao PATH [--ecustfd PATH] -o app/nutrition/starter/

--sr28 is the ASCII release, zip or folder; --fao the density workbook; --ecustfd its density.xls, whose medians are
otherwise taken from starter/ecustfd.csv. Writes foods.json, nutrients.csv and, with --ecustfd, ecustfd.csv. The same
inputs give the same bytes. Needs the development tool openpyxl, for --ecustfd also xlrd.
"""

import argparse
import csv
import io
import json
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from app.nutrition.components import COMPONENTS
from app.nutrition.density import KIND_OF_FORM
from app.nutrition.foods import Density, FoodForm, RefusePart, parse_table
from app.nutrition.importers.ecustfd import MeasuredDensity, measured_density, read_measured, read_specimens
from app.nutrition.importers.ecustfd import write_measured as ecustfd_csv
from app.nutrition.importers.fao_density import FaoRow, read_fao_rows
from app.nutrition.importers.imported import Skipped
from app.nutrition.importers.sr28 import Sr28Food, Sr28Release, parse_refuse
from app.nutrition.portion_density import group_medians, portion_densities, portion_density, usual_relative_sd
from app.nutrition.portions import Portion
from app.nutrition.usual_form import usual_state

STARTER_DIR = Path(__file__).parent / "starter"

# The components that most studies ask for; the whole release has 150 (tada foods import sr28).
_LAST_COMPONENT = "VITK1"
_TAGNAMES = [component.tagname or "" for component in COMPONENTS]
TAGNAMES = {c.tagname: c.number for c in COMPONENTS[: _TAGNAMES.index(_LAST_COMPONENT) + 1] if c.tagname}
RELATED_FACTOR = 2.0  # another food's figure is worth half


class StarterSources:
    """What the table is built from, read once: the releases and the medians of each food group."""

    def __init__(self, release: Sr28Release, fao: Mapping[int, FaoRow], ecustfd: Mapping[str, MeasuredDensity]) -> None:
        self.release = release
        self.groups = release.groups()
        self.foods = release.foods()
        self.portions = release.portions(Skipped())
        self.fao = fao
        self.ecustfd = ecustfd
        self.group_medians = group_medians(
            ((self.groups[food.group_code], self.portions.get(ndb, [])) for ndb, food in self.foods.items()),
            "USDA SR28",
        )

    def portion(self, ndb_number: str, sequence: str) -> Portion:
        """One portion. Raises ValueError if SR28 has no such portion."""
        for portion in self.portions.get(ndb_number, []):
            if portion.sequence == sequence:
                return portion
        raise ValueError(f"SR28 has no portion {sequence} of food {ndb_number}")


def build(sources: StarterSources, selection: Mapping[str, Any]) -> tuple[bytes, bytes]:
    """The selection's foods -> foods.json and nutrients.csv.

    Raises ValueError where the selection and the releases differ.
    """
    chosen = selection["food"]
    contents = sources.release.contents([entry["ndb"] for entry in chosen])
    lines = [json.dumps(_food(sources, entry), ensure_ascii=False, separators=(",", ":")) for entry in chosen]
    release = json.dumps({key: str(value) for key, value in selection["release"].items()}, ensure_ascii=False)
    foods_json = f'{{"release":{release},\n"foods":[\n' + ",\n".join(lines) + "\n]}\n"
    return foods_json.encode(), _nutrients_csv(chosen, contents).encode()


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m app.nutrition.build_starter", description="Build the food table.")
    parser.add_argument("--sr28", type=Path, required=True, help="USDA SR28, ASCII release: zip or folder")
    parser.add_argument("--fao", type=Path, required=True, help="FAO/INFOODS Density Database 2.0, xlsx")
    parser.add_argument("--ecustfd", type=Path, help="ECUSTFD density.xls (needs xlrd); else starter/ecustfd.csv")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write the table into")
    options = parser.parse_args(arguments)
    measured_csv = (STARTER_DIR / "ecustfd.csv").read_text()
    if options.ecustfd:
        specimens = read_specimens(options.ecustfd)
        measured_csv = ecustfd_csv([measured_density(food, pieces) for food, pieces in specimens.items()])
        (options.output / "ecustfd.csv").write_text(measured_csv)
    sources = StarterSources(Sr28Release(options.sr28), read_fao_rows(options.fao), read_measured(measured_csv))
    foods_json, nutrients_csv = build(sources, tomllib.loads((STARTER_DIR / "selection.toml").read_text()))
    table = parse_table(foods_json, nutrients_csv)  # what cannot be loaded is not written
    (options.output / "foods.json").write_bytes(foods_json)
    (options.output / "nutrients.csv").write_bytes(nutrients_csv)
    sys.stdout.write(f"{table.name} {table.version}: {len(table.foods)} foods, checksum {table.checksum[:12]}\n")


def _food(sources: StarterSources, entry: Mapping[str, Any]) -> dict[str, Any]:
    source = sources.foods[entry["ndb"]]
    return {
        "key": entry["key"],
        "name": entry["name"],
        "aliases": entry.get("aliases", []),
        "food_group": sources.groups[source.group_code],
        "form": entry["form"],
        "slice_form": entry.get("slice_form"),
        "refuse": [asdict(part) for part in _refuse(source, entry)],
        "densities": [asdict(density) for density in _densities(sources, source, entry)],
        "source_ids": {"sr28_ndb": source.ndb_number, "sr28_name": source.name},
        "state": usual_state(source.name),
        "is_mixed_dish": entry.get("mixed_dish", False),
        "portions": [asdict(portion) for portion in sources.portions.get(source.ndb_number, [])],
        "probes": entry.get("probes", []),
    }


def _refuse(source: Sr28Food, entry: Mapping[str, Any]) -> list[RefusePart]:
    served_without = entry.get("served_without", [])
    parts = parse_refuse(source.refuse_words, source.refuse_percent)
    unknown = set(served_without) - {part for part, _ in parts}
    if unknown:
        raise ValueError(f"{entry['key']}: SR28 names no part {sorted(unknown)} among {parts}")
    return [RefusePart(part, percent, part not in served_without) for part, percent in parts]


def _densities(sources: StarterSources, source: Sr28Food, entry: Mapping[str, Any]) -> list[Density]:
    """All that is known of the food, best first (the order of foods.DENSITY_BASES)."""
    form: FoodForm = entry["form"]
    state: str = entry["state"]
    found = []
    if "ecustfd" in entry:
        measured = sources.ecustfd[entry["ecustfd"]]
        text = f'ECUSTFD (Liang and Li 2017), sheet "{measured.food}": median of {measured.specimens} specimens'
        text += f", {measured.excluded} impossible ones left out" if measured.excluded else ""
        found.append(
            Density(measured.g_per_ml, measured.sd_g_per_ml, entry["ecustfd_state"], "solid", "measured", text)
        )
    found += [_fao_density(sources.fao, form, choice) for choice in entry.get("fao", [])]
    found += portion_densities(
        sources.portions.get(source.ndb_number, []),
        form,
        state,
        f"USDA SR28, NDB {source.ndb_number}",
        usual_portion=entry.get("usual_portion"),
        cup_kind=entry.get("cup_kind"),
    )
    kind = KIND_OF_FORM[form]
    for ndb_number, sequence in entry.get("related", []):
        portion, sd = sources.portion(ndb_number, sequence), RELATED_FACTOR * usual_relative_sd(form, kind)
        text = f'USDA SR28, NDB {ndb_number} "{sources.foods[ndb_number].name}"'
        found.append(portion_density(portion, text, kind, state, "related", sd))
    of_group = sources.group_medians.get((sources.groups[source.group_code], kind))
    if form != "liquid" and of_group is not None:
        found.append(of_group)
    if not any(density.kind == kind for density in found):
        raise ValueError(f"{entry['key']}: no {kind} density for a food that is {form}")
    return found


def _fao_density(rows: Mapping[int, FaoRow], form: FoodForm, choice: Mapping[str, Any]) -> Density:
    row, kind = rows[choice["row"]], choice["kind"]
    if row.name != choice["name"]:
        raise ValueError(f"FAO row {row.row} is {row.name!r}, the selection says {choice['name']!r}")
    relative_sd = choice.get("relative_sd", usual_relative_sd(form, kind))
    sd = max(relative_sd * row.g_per_ml, row.half_range_g_per_ml)
    text = f'FAO/INFOODS 2012, Density Database 2.0, row {row.row} "{row.name}" ({row.biblio_id})'
    return Density(round(row.g_per_ml, 3), round(sd, 3), choice["state"], kind, "fao", text)


def _nutrients_csv(chosen: Sequence[Mapping[str, Any]], contents: Mapping[str, Mapping[str, float]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, ["key", *TAGNAMES], restval="", lineterminator="\n")
    writer.writeheader()
    for entry in chosen:
        content = contents[entry["ndb"]]
        row = {tagname: f"{content[number]:g}" for tagname, number in TAGNAMES.items() if number in content}
        writer.writerow({"key": entry["key"], **row})
    return text.getvalue()


if __name__ == "__main__":
    main()
