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
import re
import statistics
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from app.nutrition.components import COMPONENTS
from app.nutrition.density import KIND_OF_FORM
from app.nutrition.foods import Density, DensityBasis, DensityKind, FoodForm, RefusePart, parse_table
from app.nutrition.importers.ecustfd import MeasuredDensity, measured_density, read_measured, read_specimens
from app.nutrition.importers.ecustfd import write_measured as ecustfd_csv
from app.nutrition.importers.fao_density import FaoRow, read_fao_rows
from app.nutrition.importers.sr28 import Sr28Food, Sr28Portion, Sr28Release, parse_refuse
from app.units import Unit

STARTER_DIR = Path(__file__).parent / "starter"

# Neither table publishes a spread. Judged (docs/food-table.md, "Spread"): liquids differ little; two tables' figures
# for the same cooked, heaped food differ by 2 to 12 %, to which the next heap's own packing is added.
_RELATIVE_SD: Mapping[str, float] = {"liquid": 0.02, "solid": 0.08, "bulk": 0.12}
RELATED_FACTOR = 2.0  # another food's figure is worth half
GROUP_RELATIVE_SD = 0.25  # at least
MIN_GROUP_FOODS = 5
_SMALL_UNITS = frozenset({Unit.TABLESPOON, Unit.FLUID_OUNCE})  # their weights are rounded more coarsely than a cup's
_ROBUST_SD = 0.7413  # standard deviation of a normal distribution a unit of interquartile range

_SOLID_WORDS = re.compile(r"\b(mashed|pureed|melted)\b")
_GROUP_SOLID_WORDS = re.compile(r"\b(mashed|pureed|cubic inch)\b")
_GROUP_BULK_WORDS = re.compile(r"\b(chopped|diced|sliced|slices|cubes|chunks|pieces|whole|halves|shredded)\b")
_MEASURE_NOISE = re.compile(r"\b(serving|1/2|1|cups?|fl|oz|tbsp|8|4|NLEA)\b|[(),]")


class StarterSources:
    """What the table is built from, read once: the releases and the medians of each food group."""

    def __init__(self, release: Sr28Release, fao: Mapping[int, FaoRow], ecustfd: Mapping[str, MeasuredDensity]) -> None:
        self.release = release
        self.groups = release.groups()
        self.foods = release.foods()
        self.portions = release.volume_portions()
        self.fao = fao
        self.ecustfd = ecustfd

    def portion(self, ndb_number: str, sequence: str) -> Sr28Portion:
        """One volume portion. Raises ValueError if SR28 has no such portion, or it is no volume."""
        for portion in self.portions.get(ndb_number, []):
            if portion.sequence == sequence:
                return portion
        raise ValueError(f"SR28 has no volume portion {sequence} of food {ndb_number}")

    def group_densities(self, group_code: str, kind: DensityKind) -> list[float]:
        """Each food of the group that has portions of this kind: their median density, g/ml."""
        words = _GROUP_SOLID_WORDS if kind == "solid" else _GROUP_BULK_WORDS
        found = []
        for ndb_number, portions in self.portions.items():
            densities = [portion.density_g_per_ml for portion in portions if words.search(portion.measure)]
            if densities and self.foods[ndb_number].group_code == group_code:
                found.append(statistics.median(densities))
        return found


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
    found += _own_portion_densities(sources.portions.get(source.ndb_number, []), source, entry)
    for ndb_number, sequence in entry.get("related", []):
        portion, kind = sources.portion(ndb_number, sequence), KIND_OF_FORM[form]
        sd = RELATED_FACTOR * _relative_sd(form, kind)
        found.append(_portion_density(portion, sources.foods[ndb_number], kind, state, "related", sd))
    group = sources.group_densities(source.group_code, KIND_OF_FORM[form])
    if form != "liquid" and len(group) >= MIN_GROUP_FOODS:
        found.append(_group_density(group, sources.groups[source.group_code], KIND_OF_FORM[form]))
    if not any(density.kind == KIND_OF_FORM[form] for density in found):
        raise ValueError(f"{entry['key']}: no {KIND_OF_FORM[form]} density for a food that is {form}")
    return found


def _own_portion_densities(
    portions: Sequence[Sr28Portion], source: Sr28Food, entry: Mapping[str, Any]
) -> list[Density]:
    """One density a kind and state, the usual portion's first; of a cup and a tablespoon of the same, the cup's."""
    form, usual = entry["form"], entry.get("usual_portion")
    found: dict[tuple[DensityKind, str], Density] = {}
    for portion in sorted(portions, key=lambda portion: (portion.sequence != usual, portion.unit in _SMALL_UNITS)):
        kind, state = _kind_and_state(portion, form, entry["state"], entry.get("cup_kind"))
        density = _portion_density(portion, source, kind, state, "portion", _relative_sd(form, kind))
        found.setdefault((kind, state), density)
    return list(found.values())


def _fao_density(rows: Mapping[int, FaoRow], form: FoodForm, choice: Mapping[str, Any]) -> Density:
    row, kind = rows[choice["row"]], choice["kind"]
    if row.name != choice["name"]:
        raise ValueError(f"FAO row {row.row} is {row.name!r}, the selection says {choice['name']!r}")
    relative_sd = choice.get("relative_sd", _relative_sd(form, kind))
    sd = max(relative_sd * row.g_per_ml, row.half_range_g_per_ml)
    text = f'FAO/INFOODS 2012, Density Database 2.0, row {row.row} "{row.name}" ({row.biblio_id})'
    return Density(round(row.g_per_ml, 3), round(sd, 3), choice["state"], kind, "fao", text)


def _portion_density(
    portion: Sr28Portion, food: Sr28Food, kind: DensityKind, state: str, basis: DensityBasis, relative_sd: float
) -> Density:
    g_per_ml = portion.density_g_per_ml
    name = "" if basis == "portion" else f' "{food.name}"'
    text = f"USDA SR28, NDB {food.ndb_number}{name}, portion {portion.sequence}: "
    text += f"{portion.amount:g} {portion.unit} ({portion.measure}) {portion.mass_g:g} g"
    return Density(round(g_per_ml, 3), round(relative_sd * g_per_ml, 3), state, kind, basis, text)


def _group_density(densities: Sequence[float], group: str, kind: DensityKind) -> Density:
    lower, median, upper = statistics.quantiles(densities, n=4)
    sd = max(GROUP_RELATIVE_SD * median, _ROBUST_SD * (upper - lower))
    text = f"USDA SR28, volume portions: median of {len(densities)} foods of the group {group}"
    return Density(round(median, 3), round(sd, 3), "any", kind, "group", text)


def _kind_and_state(
    portion: Sr28Portion, form: FoodForm, state: str, cup_kind: DensityKind | None
) -> tuple[DensityKind, str]:
    """What a portion's words say: mashed is solid, chopped is a heap, a plain cup is the food as it usually is."""
    if portion.unit == Unit.CUBIC_INCH:
        return "solid", state
    pressed = _SOLID_WORDS.search(portion.measure)
    if pressed:
        return "solid", pressed[1]
    words = " ".join(_MEASURE_NOISE.sub(" ", portion.measure).split())
    if words:
        return "bulk", words[:32]
    usual = KIND_OF_FORM[form] if form in {"liquid", "heap", "in_vessel"} else "bulk"
    return cup_kind or usual, state


def _relative_sd(form: FoodForm, kind: DensityKind) -> float:
    return _RELATIVE_SD["liquid" if form == "liquid" else kind]


def _nutrients_csv(chosen: Sequence[Mapping[str, Any]], contents: Mapping[str, Mapping[str, float]]) -> str:
    text = io.StringIO()
    tagnames = [component.tagname for component in COMPONENTS]
    writer = csv.DictWriter(text, ["key", *tagnames], restval="", lineterminator="\n")
    writer.writeheader()
    for entry in chosen:
        row = {tagname: f"{content:g}" for tagname, content in contents[entry["ndb"]].items()}
        writer.writerow({"key": entry["key"], **row})
    return text.getvalue()


if __name__ == "__main__":
    main()
