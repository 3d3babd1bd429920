"""Read and validate USDA's National Nutrient Database for Standard Reference, release 28, ASCII, as zip or folder.

Fields are separated by ^, texts enclosed in ~, lines end in CR LF (in WEIGHT.txt CR CR LF), the
encoding is Windows-1252 (only NUTR_DEF.txt uses it, for the micro sign). Documented in sr28_doc.pdf
of the release. In the published release every food has nutrient values and every value its food;
otherwise a file was truncated or altered.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

from app.foods.importers.source_files import (
    MAX_GROUP,
    MAX_MEASURE,
    MAX_NAME,
    ImportedTable,
    ImportFileError,
    Place,
    Skipped,
    SourceComponent,
    SourceFiles,
    sorted_components,
    source_component,
)
from app.nutrition.foods import Food, FoodTable, RefusePart
from app.nutrition.group_density import kind_density, starter_foods_by_ndb, with_group_medians
from app.nutrition.portion_density import portion_densities
from app.nutrition.portions import Portion
from app.nutrition.usual_form import cup_kind, is_mixed_dish, is_served, usual_form, usual_state

FORMAT = "sr28"
FILES = ("FD_GROUP.txt", "NUTR_DEF.txt", "FOOD_DES.txt", "NUT_DATA.txt", "WEIGHT.txt")
RELEASED_ON = date(2016, 5, 1)  # September 2015, revised May 2016
ENCODING = "cp1252"

_PERCENT_FIRST = re.compile(r"^(?P<percent>\d+(?:\.\d+)?)\s*%\s*(?P<part>.+)$")
# codes of the meat trade and of government programmes
_NO_ALIAS = re.compile(r"URMIS|commodity|\d{3}", re.IGNORECASE)
_PERCENT_LAST = re.compile(r"^(?P<part>.+?),?\s*(?P<percent>\d+(?:\.\d+)?)\s*%$")


@dataclass(frozen=True, slots=True)
class Sr28Food:
    """A line of FOOD_DES.txt.

    refuse_percent: 0 where the field is empty. refuse_words: Ref_desc as published.
    """

    ndb_number: str
    group_code: str
    name: str
    common_names: str
    refuse_percent: float
    refuse_words: str


class Sr28Release:
    """The release at a path, a zip or a folder. Raises ImportFileError if it is not such a release.

    Each file is read once and validated: fields, figures, references, duplicates.
    """

    def __init__(self, path: Path) -> None:
        self._files = SourceFiles(path)
        self._files.require(FILES)

    def checksum(self) -> str:
        """Return the SHA-256 of the files that are read, hex."""
        return self._files.checksum(FILES)

    @cached_property
    def groups(self) -> dict[str, str]:
        """FD_GROUP.txt: code -> name of each food group."""
        name, groups = "FD_GROUP.txt", dict[str, str]()
        for place, (code, group) in self._records(name, 2):
            groups[place.new_key("group", code, groups)] = place.text("the group", group, MAX_GROUP)
        return groups

    @cached_property
    def components(self) -> dict[str, SourceComponent]:
        """NUTR_DEF.txt: Nutr_No -> component, with the factor of its figures."""
        name, components = "NUTR_DEF.txt", dict[str, SourceComponent]()
        for place, fields in self._records(name, 6):
            number = place.new_key("nutrient", fields[0], components)
            components[number] = source_component(place, number, fields[3], fields[1])
        return components

    @cached_property
    def foods(self) -> dict[str, Sr28Food]:
        """FOOD_DES.txt: NDB number -> food."""
        name, foods = "FOOD_DES.txt", dict[str, Sr28Food]()
        for place, fields in self._records(name, 14):
            number = place.new_key("food", fields[0], foods)
            food_name = place.text(f"the name of food {number}", fields[2], MAX_NAME)
            if fields[1] not in self.groups:
                raise place.error(
                    f"food {number} is of group {fields[1]}, which FD_GROUP.txt lacks"
                )
            percent = place.number("the refuse", fields[8] or "0")
            if percent >= 100.0:
                raise place.error(f"a refuse of {percent:g} % leaves nothing of food {number}")
            foods[number] = Sr28Food(number, fields[1], food_name, fields[4], percent, fields[7])
        return foods

    def contents(self, ndb_numbers: Collection[str]) -> dict[str, dict[str, float]]:
        """NUT_DATA.txt: NDB number -> component number -> content of 100 g edible portion, for these foods."""
        name = "NUT_DATA.txt"
        contents: dict[str, dict[str, float]] = {number: {} for number in ndb_numbers}
        for place, fields in self._records(name, 18):
            self._require_food(place, fields[0])
            source = self.components.get(fields[1])
            if source is None:
                raise place.error(f"nutrient {fields[1]} is none of NUTR_DEF.txt")
            of_food = contents.get(fields[0])
            if of_food is None:
                continue
            number = source.component.number
            if number in of_food:
                raise place.error(f"nutrient {number} of food {fields[0]} is there twice")
            of_food[number] = place.number(f"nutrient {number}", fields[2]) * source.factor
        for ndb_number, of_food in contents.items():
            if not of_food:
                raise ImportFileError(
                    name, None, f"it has no value of food {ndb_number}; is the file cut off?"
                )
        return contents

    def portions(self, skipped: Skipped) -> dict[str, list[Portion]]:
        """WEIGHT.txt: NDB number -> its household measures, in the file's order."""
        portions, keys = dict[str, list[Portion]](), set[str]()
        for place, fields in self._records("WEIGHT.txt", 7):
            self._require_food(place, fields[0])
            keys.add(place.new_key("portion", f"{fields[0]} {fields[1]}", keys))
            amount = place.number("the amount", fields[2])
            mass_g = place.number("the weight", fields[4])
            if amount == 0.0 or mass_g == 0.0:
                skipped.add("portions of no amount or weight", f"{fields[0]} {fields[3]}")
                continue
            measure = place.text("the measure", fields[3], MAX_MEASURE)
            portions.setdefault(fields[0], []).append(Portion(fields[1], amount, measure, mass_g))
        return portions

    def _require_food(self, place: Place, ndb_number: str) -> None:
        if ndb_number not in self.foods:
            raise place.error(f"food {ndb_number} is none of FOOD_DES.txt; is one of them cut off?")

    def _records(self, name: str, fields_per_line: int) -> Iterator[tuple[Place, list[str]]]:
        number = 0
        for number, line in self._files.lines(name, ENCODING):
            place = Place(name, number)
            raw = [field.strip() for field in line.split("^")]
            if len(raw) != fields_per_line:
                raise place.error(
                    f"{len(raw)} fields where SR28 has {fields_per_line}; is the file cut off?"
                )
            # The last field of FD_GROUP.txt is a text: cut within it the count is still right.
            if raw[-1].startswith("~") and (raw[-1] == "~" or not raw[-1].endswith("~")):
                raise place.error(f"the text {raw[-1]} has no end; is the file cut off?")
            yield place, [field.strip("~") for field in raw]
        if number == 0:
            raise ImportFileError(name, None, "it is empty")


def read_sr28(path: Path) -> ImportedTable:
    """Read and validate the whole release.

    Raises ImportFileError, with file and line, at the first error.
    """
    release, skipped = Sr28Release(path), Skipped()
    contents, portions = release.contents(release.foods), release.portions(skipped)
    foods = [
        _food(source, release.groups[source.group_code], contents[number], portions.get(number, []))
        for number, source in release.foods.items()
    ]
    components = {
        source.component.number: source.component for source in release.components.values()
    }
    foods_with_medians = with_group_medians(
        foods, "USDA SR28 and the starter table", starter_foods_by_ndb()
    )
    table = FoodTable("sr28", "28", RELEASED_ON, release.checksum(), foods_with_medians)
    return ImportedTable(FORMAT, table, sorted_components(components), skipped)


def _food(
    source: Sr28Food, group: str, per_100_g: Mapping[str, float], portions: list[Portion]
) -> Food:
    form, state = usual_form(source.name, group), usual_state(source.name)
    densities = portion_densities(
        portions,
        form,
        state,
        f"USDA SR28, NDB {source.ndb_number}",
        cup_kind=cup_kind(source.name, group, form),
    )
    return Food(
        key=f"sr28:{source.ndb_number}",
        name=source.name,
        aliases=_aliases(source),
        food_group=group,
        form=form,
        refuse=tuple(
            RefusePart(part, percent, is_served=is_served(part, source.name, form))
            for part, percent in parse_refuse(source.refuse_words, source.refuse_percent)
        ),
        densities=(*densities, *kind_density(source.name, group, form)),
        per_100_g=MappingProxyType(per_100_g),
        source_ids={"sr28_ndb": source.ndb_number},
        state=state,
        is_mixed_dish=is_mixed_dish(source.name, group),
        portions=tuple(portions),
    )


def parse_refuse(description: str, percent: float) -> list[tuple[str, float]]:
    """Parse Ref_desc and Refuse of a food: parts with their percent of the whole food; [] if there is no refuse.

    "8% core, 16% crown, 26% parings" gives three parts, "Core and stem" one. The published parts
    are rounded and may not add up to the published total (here 50 and 49), so they are scaled to
    it.
    """
    if percent == 0.0:
        return []
    parts: list[tuple[str, float]] = []
    for piece in re.split(
        r"[,;]", re.sub(r",\s*(?=\d+(?:\.\d+)?\s*%\s*(?:,|;|$))", " ", description)
    ):
        match = _PERCENT_FIRST.match(piece.strip()) or _PERCENT_LAST.match(piece.strip())
        if match is None or float(match["percent"]) == 0.0:
            parts = []
            break
        parts.append((match["part"].strip().lower(), float(match["percent"])))
    if not parts:
        return [(description.strip().lower() or "refuse", percent)]
    scale = percent / sum(share for _, share in parts)
    return [(part, round(share * scale, 2)) for part, share in parts]


def _aliases(source: Sr28Food) -> tuple[str, ...]:
    """Return the common names without codes and words of the name itself ("Beef" of "Beef, chuck, short ribs ...")."""
    name_words = set(re.findall(r"\w+", source.name.lower()))
    names = (name.strip() for name in re.split(r"[,;]", source.common_names))
    return tuple(
        dict.fromkeys(
            name
            for name in names
            if name
            and not _NO_ALIAS.search(name)
            and not set(re.findall(r"\w+", name.lower())) <= name_words
        )
    )
