"""All the densities that the starter table's sources know of a food, best first, as its entry in selection.toml says.

Which row or portion fits a food is judged by hand, in the selection; here is how each kind of source becomes a
density with its spread, and how it is cited.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from app.foods.importers.fao_density import FaoRow, fao_density
from app.foods.importers.source_files import Skipped
from app.foods.importers.sr28 import Sr28Release
from app.nutrition.components import NUMBER_BY_TAGNAME
from app.nutrition.density import KIND_OF_FORM
from app.nutrition.foods import DENSITY_BASES, Density, DensityBasis, FoodForm
from app.nutrition.portion_density import (
    group_medians,
    portion_densities,
    portion_density,
    usual_relative_sd,
)
from app.nutrition.portions import Portion
from tools.ecustfd import MeasuredDensity
from tools.starter_table.piece_sizes import piece_volume_ml
from tools.starter_table.pore_free import pore_free_density

# Judged, as no source publishes what the next item may differ by (docs/food-table.md, "Spread").
RELATED_FACTOR = 2.0  # another food's figure is worth half
PIECE_RELATIVE_SD = 0.15  # nominal sizes against cubic inches of the same food: 2 to 15 %
PORE_FREE_RELATIVE_SD = 0.10
PORE_FREE_LIQUID_RELATIVE_SD = 0.03  # drinks: 1 to 2 % off their fluid ounce
CRUMB_RELATIVE_SD = 0.30

_CARBOHYDRATE = NUMBER_BY_TAGNAME["CHOCDF"]

Entry = Mapping[str, Any]


class StarterSources:
    """What the table is built from, read once: the releases, the selection, the medians of each food group."""

    def __init__(
        self,
        release: Sr28Release,
        fao: Mapping[int, FaoRow],
        ecustfd: Mapping[str, MeasuredDensity],
        selection: Mapping[str, Any],
    ) -> None:
        self.groups = release.groups
        self.foods = release.foods
        self.portions = release.portions(Skipped())
        self.fao = fao
        self.ecustfd = ecustfd
        self.literature = {work["id"]: work for work in selection.get("literature", [])}
        self.entries = {entry["key"]: entry for entry in selection["food"]}
        self.contents = release.contents([entry["ndb"] for entry in selection["food"]])
        self.group_medians = group_medians(
            (
                (self.groups[food.group_code], self.portions.get(ndb, []))
                for ndb, food in self.foods.items()
            ),
            "USDA SR28",
        )

    def portion(self, ndb_number: str, sequence: str) -> Portion:
        """One portion. Raises ValueError if SR28 has no such portion."""
        for portion in self.portions.get(ndb_number, []):
            if portion.sequence == sequence:
                return portion
        raise ValueError(f"SR28 has no portion {sequence} of food {ndb_number}")

    def own_portions(self, entry: Entry) -> list[Portion]:
        """The food's portions but for those that the selection drops. Raises ValueError if one of them is not there."""
        dropped = entry.get("drop_portions", [])
        for sequence in dropped:
            self.portion(entry["ndb"], sequence)
        return [
            portion
            for portion in self.portions.get(entry["ndb"], [])
            if portion.sequence not in dropped
        ]


def starter_densities(sources: StarterSources, entry: Entry) -> list[Density]:
    """All that is known of the food, in the order of foods.DENSITY_BASES; the group's median only for want of better.

    Raises ValueError if none is of the kind that the food's form takes, or where selection and sources differ.
    """
    form: FoodForm = entry["form"]
    kind = KIND_OF_FORM[form]
    found = [
        *_measured(sources, entry),
        *(_fao(sources.fao, form, choice) for choice in entry.get("fao", [])),
        *portion_densities(
            sources.own_portions(entry),
            form,
            entry["state"],
            f"USDA SR28, NDB {entry['ndb']}",
            usual_portion=entry.get("usual_portion"),
            cup_kind=entry.get("cup_kind"),
        ),
        *_related(sources, entry),
        *(_piece(sources, entry, *piece) for piece in entry.get("pieces", [])),
        *_from_composition(sources, entry),
    ]
    if not any(density.kind == kind for density in found):
        of_group = sources.group_medians.get(
            (sources.groups[sources.foods[entry["ndb"]].group_code], kind)
        )
        if form == "liquid" or of_group is None:
            raise ValueError(f"{entry['key']}: no {kind} density for a food that is {form}")
        found.append(of_group)
    return sorted(found, key=lambda density: DENSITY_BASES.index(density.basis))


def _measured(sources: StarterSources, entry: Entry) -> list[Density]:
    found = [
        _literature(sources.literature[name], "measured") for name in entry.get("literature", [])
    ]
    if "ecustfd" in entry:
        measured, least_sd = (
            sources.ecustfd[entry["ecustfd"]],
            entry.get("ecustfd_relative_sd", 0.0),
        )
        found.append(_ecustfd(measured, entry["ecustfd_state"], "measured", least_sd))
    return found


def _related(sources: StarterSources, entry: Entry) -> list[Density]:
    form: FoodForm = entry["form"]
    kind = KIND_OF_FORM[form]
    found = [
        _literature(sources.literature[name], "related")
        for name in entry.get("related_literature", [])
    ]
    if "related_ecustfd" in entry:
        found.append(_ecustfd(sources.ecustfd[entry["related_ecustfd"]], entry["state"], "related"))
    for ndb_number, sequence in entry.get("related", []):
        portion, sd = (
            sources.portion(ndb_number, sequence),
            RELATED_FACTOR * usual_relative_sd(form, kind),
        )
        text = _of_relative(sources, ndb_number)
        found.append(portion_density(portion, text, kind, entry["state"], "related", sd))
    return found


def _literature(work: Mapping[str, Any], basis: DensityBasis) -> Density:
    factor = RELATED_FACTOR if basis == "related" else 1.0
    return _solid(
        work["g_per_ml"], factor * work["relative_sd"], work["state"], basis, work["source"]
    )


def _ecustfd(
    measured: MeasuredDensity, state: str, basis: DensityBasis, least_relative_sd: float = 0.0
) -> Density:
    text = f'ECUSTFD (Liang and Li 2017), sheet "{measured.food}": median of {measured.specimens} specimens'
    text += f", {measured.excluded} impossible ones left out" if measured.excluded else ""
    factor = RELATED_FACTOR if basis == "related" else 1.0
    relative_sd = max(factor * measured.sd_g_per_ml / measured.g_per_ml, least_relative_sd)
    return _solid(measured.g_per_ml, relative_sd, state, basis, text)


def _fao(rows: Mapping[int, FaoRow], form: FoodForm, choice: Mapping[str, Any]) -> Density:
    row, kind = rows[choice["row"]], choice["kind"]
    if row.name != choice["name"]:
        raise ValueError(
            f"FAO row {row.row} is {row.name!r}, the selection says {choice['name']!r}"
        )
    return fao_density(row, form, kind, choice["state"], relative_sd=choice.get("relative_sd"))


def _piece(sources: StarterSources, entry: Entry, ndb_number: str, sequence: str) -> Density:
    portion = sources.portion(ndb_number, sequence)
    volume_ml = piece_volume_ml(portion.measure)
    if volume_ml is None:
        raise ValueError(
            f"{entry['key']}: portion {sequence} of {ndb_number} gives no size: {portion.measure}"
        )
    is_own = ndb_number == entry["ndb"]
    text = f"USDA SR28, NDB {ndb_number}" if is_own else _of_relative(sources, ndb_number)
    text += f", portion {sequence}: {portion.amount:g} {portion.measure} {portion.mass_g:g} g"
    relative_sd = PIECE_RELATIVE_SD if is_own else RELATED_FACTOR * PIECE_RELATIVE_SD
    g_per_ml = portion.mass_g / (portion.amount * volume_ml)
    return _solid(g_per_ml, relative_sd, entry["state"], "portion" if is_own else "related", text)


def _from_composition(sources: StarterSources, entry: Entry) -> list[Density]:
    contents = sources.contents[entry["ndb"]]
    words = "pore-free density of its composition (Choi and Okos 1986)"
    if entry.get("pore_free"):
        g_per_ml = pore_free_density(contents)
        if g_per_ml is None:
            raise ValueError(f"{entry['key']}: SR28 does not give its composition")
        relative_sd = (
            PORE_FREE_LIQUID_RELATIVE_SD if entry["form"] == "liquid" else PORE_FREE_RELATIVE_SD
        )
        solid = _solid(g_per_ml, relative_sd, entry["state"], "composition", words)
        return [
            replace(solid, kind=KIND_OF_FORM[entry["form"]])
        ]  # without air a bowl of it is as dense as a piece
    if "crumb" not in entry:
        return []
    of = sources.entries[entry["crumb"]["of"]]
    crumb = next(density for density in starter_densities(sources, of) if density.kind == "solid")
    of_crumb = sources.contents[of["ndb"]]
    share = entry["crumb"].get("share", contents[_CARBOHYDRATE] / of_crumb[_CARBOHYDRATE])
    g_per_ml = _crumb_and_rest(contents, of_crumb, share, crumb.g_per_ml)
    text = f"{share:.0%} {of['name']} ({crumb.g_per_ml:g} g/ml), the rest by the {words}"
    return [_solid(g_per_ml, CRUMB_RELATIVE_SD, entry["state"], "composition", text)]


def _crumb_and_rest(
    contents: Mapping[str, float],
    of_crumb: Mapping[str, float],
    share: float,
    crumb_g_per_ml: float,
) -> float:
    """Density of a dish that is crumb by `share` of its mass: volumes add up. Raises ValueError if there is no rest."""
    if not 0.0 < share < 1.0:
        raise ValueError(f"a share of {share:.2f} crumb leaves no rest")
    rest_g_per_ml = pore_free_density(
        {
            number: max(0.0, content - share * of_crumb.get(number, 0.0)) / (1.0 - share)
            for number, content in contents.items()
        }
    )
    if rest_g_per_ml is None:
        raise ValueError("the rest of the crumb is of unknown composition")
    return 1.0 / (share / crumb_g_per_ml + (1.0 - share) / rest_g_per_ml)


def _of_relative(sources: StarterSources, ndb_number: str) -> str:
    return f'USDA SR28, NDB {ndb_number} "{sources.foods[ndb_number].name}"'


def _solid(
    g_per_ml: float, relative_sd: float, state: str, basis: DensityBasis, source: str
) -> Density:
    return Density(
        round(g_per_ml, 3), round(relative_sd * g_per_ml, 3), state, "solid", basis, source[:300]
    )
