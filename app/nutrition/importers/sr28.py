"""USDA National Nutrient Database for Standard Reference, release 28, ASCII: zip or folder -> its records.

Fields are separated by ^, texts stand in ~, lines end in CR LF (in WEIGHT.txt CR CR LF), the encoding is Windows-1252
(only NUTR_DEF.txt uses it, for the micro sign). Documented in sr28_doc.pdf of the release.
"""

import re
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from app.nutrition.components import TAGNAME_BY_SR28_NUMBER
from app.units import Unit, density_from_portion

# Measures that open with a volume. Teaspoons are left out: their weights are rounded to a tenth of themselves.
_VOLUME_MEASURES = (
    (re.compile(r"(?:serving )?cups?\b"), Unit.CUP),
    (re.compile(r"(?:serving )?1/2 cup\b"), Unit.CUP),
    (re.compile(r"fl oz\b"), Unit.FLUID_OUNCE),
    (re.compile(r"tbsp\b"), Unit.TABLESPOON),
    (re.compile(r"cubic inch\b"), Unit.CUBIC_INCH),
)
_SERVING = re.compile(r"^serving 1 (?=cup\b)")
_PERCENT_FIRST = re.compile(r"^(?P<percent>\d+(?:\.\d+)?)\s*%\s*(?P<part>.+)$")
_PERCENT_LAST = re.compile(r"^(?P<part>.+?),?\s*(?P<percent>\d+(?:\.\d+)?)\s*%$")


@dataclass(frozen=True, slots=True)
class Sr28Food:
    """A line of FOOD_DES.txt. refuse_percent: 0 where the field is empty. refuse_words: Ref_desc as published."""

    ndb_number: str
    group_code: str
    name: str
    refuse_percent: float
    refuse_words: str


@dataclass(frozen=True, slots=True)
class Sr28Portion:
    """A line of WEIGHT.txt whose measure is a volume: `amount` `unit`s of the food, as `measure` says, weigh mass_g."""

    ndb_number: str
    sequence: str
    amount: float
    unit: Unit
    measure: str
    mass_g: float

    @property
    def density_g_per_ml(self) -> float:
        """Grams of edible portion a millilitre of the measure."""
        return density_from_portion(self.mass_g, self.amount, self.unit)


class Sr28Release:
    """The release at a path, a zip or a folder. Raises FileNotFoundError or ValueError if it is no such release."""

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.exists():
            raise FileNotFoundError(f"{path} does not exist; give the SR28 ASCII release as a zip or a folder")
        if path.is_file() and not zipfile.is_zipfile(path):
            raise ValueError(f"{path} is no zip file, or only a part of one; download the release again")

    def groups(self) -> dict[str, str]:
        """FD_GROUP.txt: code -> name of each food group."""
        return {fields[0]: fields[1] for fields in self._records("FD_GROUP.txt", 2)}

    def nutrient_definitions(self) -> dict[str, tuple[str, str, str]]:
        """NUTR_DEF.txt: Nutr_No -> tagname, name, unit (the micro sign as u)."""
        return {
            fields[0]: (fields[2], fields[3], fields[1].replace("\u00b5", "u"))
            for fields in self._records("NUTR_DEF.txt", 6)
        }

    def foods(self) -> dict[str, Sr28Food]:
        """FOOD_DES.txt: NDB number -> food."""
        foods = {}
        for fields in self._records("FOOD_DES.txt", 14):
            refuse_percent = float(fields[8] or 0.0)
            foods[fields[0]] = Sr28Food(fields[0], fields[1], fields[2], refuse_percent, fields[7])
        return foods

    def contents(self, ndb_numbers: Collection[str]) -> dict[str, dict[str, float]]:
        """NUT_DATA.txt: NDB number -> tagname -> content of 100 g edible portion, for these foods."""
        contents: dict[str, dict[str, float]] = {number: {} for number in ndb_numbers}
        for fields in self._records("NUT_DATA.txt", 18):
            tagname = TAGNAME_BY_SR28_NUMBER.get(fields[1])
            if tagname and fields[0] in contents:
                contents[fields[0]][tagname] = float(fields[2])
        return contents

    def volume_portions(self) -> dict[str, list[Sr28Portion]]:
        """WEIGHT.txt: NDB number -> the portions that are volumes, in the file's order."""
        portions: dict[str, list[Sr28Portion]] = {}
        for fields in self._records("WEIGHT.txt", 7):
            measure = _SERVING.sub("", fields[3])
            for pattern, unit in _VOLUME_MEASURES:
                if pattern.match(measure):
                    amount = float(fields[2]) * (0.5 if "1/2 cup" in measure else 1.0)
                    portion = Sr28Portion(fields[0], fields[1], amount, unit, fields[3], float(fields[4]))
                    portions.setdefault(fields[0], []).append(portion)
                    break
        return portions

    def _records(self, name: str, fields_per_line: int) -> Iterator[list[str]]:
        with self._open(name) as lines:
            for number, line in enumerate(lines, start=1):
                fields = [field.strip().strip("~") for field in line.decode("cp1252").strip().split("^")]
                if len(fields) != fields_per_line:
                    raise ValueError(f"{name}, line {number}: {len(fields)} fields where SR28 has {fields_per_line}")
                yield fields

    @contextmanager
    def _open(self, name: str) -> Iterator[IO[bytes]]:
        if self._path.is_dir():
            with (self._path / name).open("rb") as lines:
                yield lines
            return
        with zipfile.ZipFile(self._path) as archive:
            inside = [entry for entry in archive.namelist() if entry.rpartition("/")[2].upper() == name.upper()]
            if not inside:
                raise FileNotFoundError(f"{self._path} holds no {name}")
            with archive.open(inside[0]) as lines:
                yield lines


def parse_refuse(words: str, percent: float) -> list[tuple[str, float]]:
    """Ref_desc and Refuse of a food -> its parts with their percent of the whole food; [] if nothing is refused.

    "8% core, 16% crown, 26% parings" gives three parts, "Core and stem" one. The published parts are rounded and may
    not add up to the published total (here 50 and 49), so they are scaled to it.
    """
    if percent == 0.0:
        return []
    parts: list[tuple[str, float]] = []
    for piece in re.split(r"[,;]", re.sub(r",\s*(?=\d+(?:\.\d+)?\s*%\s*(?:,|;|$))", " ", words)):
        match = _PERCENT_FIRST.match(piece.strip()) or _PERCENT_LAST.match(piece.strip())
        if match is None:
            parts = []
            break
        parts.append((match["part"].strip().lower(), float(match["percent"])))
    if not parts:
        return [(words.strip().lower() or "refuse", percent)]
    scale = percent / sum(share for _, share in parts)
    return [(part, round(share * scale, 2)) for part, share in parts]
