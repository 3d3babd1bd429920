"""Read and validate FoodData Central's CSV release, a zip or folder, with all or some of its data sets.

Foundation, SR Legacy and Survey (FNDDS) foods are imported; branded foods and laboratory samples
are only counted. The full release has more than twenty million nutrient values, nearly all of
branded foods: files are streamed, and only rows of imported foods are kept in memory. Columns as in
the releases of 2020 to 2026; FNDDS names its nutrients by number (208), the others by id (1008).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from types import MappingProxyType

from app.foods.importers.fdc_portions import group_of_category, is_mixed_category, portion_of
from app.foods.importers.source_files import (
    MAX_GROUP,
    MAX_NAME,
    ImportedTable,
    ImportFileError,
    Skipped,
    SourceComponent,
    SourceFiles,
    sorted_components,
    source_component,
    unit_of,
)
from app.nutrition.components import Component
from app.nutrition.foods import Food, FoodState, FoodTable
from app.nutrition.group_density import kind_density, starter_foods_by_ndb, with_group_medians
from app.nutrition.portion_density import portion_densities
from app.nutrition.portions import Portion
from app.nutrition.usual_form import cup_kind, is_mixed_dish, usual_form, usual_state

FORMAT = "fdc"

# In order of preference: analysed foods first. The value is the data set's part of a release's
# name.
DATA_TYPES = {
    "foundation_food": "foundation",
    "sr_legacy_food": "sr-legacy",
    "survey_fndds_food": "survey",
}
SURVEY = "survey_fndds_food"
NDB_FILES = {"foundation_food": "foundation_food.csv", "sr_legacy_food": "sr_legacy_food.csv"}
ALWAYS = ("food.csv", "nutrient.csv", "food_nutrient.csv", "food_portion.csv", "measure_unit.csv")
OPTIONAL = (*NDB_FILES.values(), "food_category.csv", "survey_fndds_food.csv", "wweia_food_category.csv",
            "food_attribute.csv", "food_attribute_type.csv")  # fmt: skip
ALIAS_ATTRIBUTES = frozenset({"common name", "additional description"})
NO_CATEGORY = "Not in a category"

_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_Contents = dict[str, dict[str, float]]


@dataclass(frozen=True, slots=True)
class FdcFood:
    """A food of food.csv to import. line: in that file."""

    fdc_id: str
    data_type: str
    name: str
    category_id: str
    published_on: date
    line: int


@dataclass(frozen=True, slots=True)
class _Category:
    """A food category: its name, the group by which the form is inferred, whether its foods are dishes."""

    name: str
    form_group: str
    is_mixed: bool


class FdcRelease:
    """The release at a path. Each method streams and validates one file. Raises ImportFileError.

    foods: FDC id -> food, the newest version of each. skipped: things left out so far.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._files = SourceFiles(path)
        self._files.require(ALWAYS)
        self.skipped = Skipped()
        self.foods = self._all_foods()
        self.ndb_numbers, self.food_codes = self._ndb_numbers(), self._food_codes()
        self.foods = self._newest()
        self.categories = self._categories()

    def has(self, *data_types: str) -> bool:
        """Return whether there is a food of one of these types."""
        return any(food.data_type in data_types for food in self.foods.values())

    def checksum(self) -> str:
        """Return the SHA-256 of the files that are read, hex."""
        return self._files.checksum((*ALWAYS, *OPTIONAL))

    def date_in_name(self) -> date | None:
        """Return the date in the name of the zip or folder, such as FoodData_Central_csv_2025-04-24.zip."""
        match = _DATE.search(self._path.name)
        return None if match is None else date.fromisoformat(match[0])

    def _all_foods(self) -> dict[str, FdcFood]:
        """food.csv: FDC id -> food, for the data types that are taken."""
        file, foods = "food.csv", dict[str, FdcFood]()
        columns = ("fdc_id", "data_type", "description", "food_category_id", "publication_date")
        for place, (
            fdc_id,
            data_type,
            description,
            category_id,
            published,
        ) in self._files.csv_fields(file, columns):
            if data_type not in DATA_TYPES:
                self.skipped.add(f"foods of the type {data_type}", f"{fdc_id} {description}")
                continue
            place.new_key("food", fdc_id, foods)
            try:
                published_on = date.fromisoformat(published)
            except ValueError:
                raise place.error(f"publication_date is {published!r}, no date") from None
            name = place.text("description", description, MAX_NAME)
            foods[fdc_id] = FdcFood(fdc_id, data_type, name, category_id, published_on, place.line)
        if not foods:
            raise ImportFileError(file, None, f"it holds no food of {', '.join(DATA_TYPES)}")
        return foods

    def _components(self) -> dict[str, SourceComponent | None]:
        """nutrient.csv: id and number -> component; None for what no unit here measures (pH, specific gravity ...)."""
        by_id, by_number = dict[str, SourceComponent | None](), dict[str, SourceComponent | None]()
        columns = ("id", "name", "unit_name", "nutrient_nbr")
        for place, (nutrient_id, name, unit, raw_number) in self._files.csv_fields(
            "nutrient.csv", columns
        ):
            place.new_key("nutrient", nutrient_id, by_id)
            number = raw_number.removesuffix(".0")
            if not number:
                self.skipped.add("nutrients without a number", f"{nutrient_id} {name}")
                by_id[nutrient_id] = None
            elif unit_of(unit) is None:
                self.skipped.add(f"nutrients in {unit}", f"{number} {name}")
                by_id[nutrient_id] = by_number[number] = None
            else:
                by_id[nutrient_id] = source_component(place, number, name[:200], unit)
                by_number.setdefault(number, by_id[nutrient_id])
        return {**by_number, **by_id}  # ids run from 1001, numbers stay below 1000

    def contents(self) -> tuple[_Contents, dict[str, Component]]:
        """food_nutrient.csv: FDC id -> component number -> content of 100 g; and the components that occur."""
        components, contents, used = self._components(), _Contents(), dict[str, Component]()
        contradicted: set[tuple[str, str]] = set()
        columns = ("fdc_id", "nutrient_id", "amount")
        for place, (fdc_id, nutrient_id, amount) in self._files.csv_fields(
            "food_nutrient.csv", columns, of=self.foods
        ):
            if nutrient_id not in components:
                raise place.error(
                    f"nutrient {nutrient_id} of food {fdc_id} is none of nutrient.csv"
                )
            source = components[nutrient_id]
            if source is None:
                self.skipped.add("values of nutrients that are left out", f"{fdc_id} {nutrient_id}")
                continue
            number = source.component.number
            example = f"{fdc_id} {number} {source.component.name}"
            if not amount:
                self.skipped.add("values without an amount", example)
                continue
            if amount.startswith("-"):
                place.number(f"nutrient {nutrient_id}", amount[1:])
                self.skipped.add("values below zero (by difference)", example)
                continue
            value = place.number(f"nutrient {nutrient_id}", amount) * source.factor
            if contents.setdefault(fdc_id, {}).setdefault(number, value) != value:
                contradicted.add((fdc_id, number))
            used[number] = source.component
        for fdc_id, number in sorted(contradicted):
            del contents[fdc_id][number]
            self.skipped.add("values that are given twice and differ", f"{fdc_id} {number}")
        return contents, used

    def portions(self) -> dict[str, list[Portion]]:
        """food_portion.csv: FDC id -> its household measures, in the file's order."""
        units = {
            unit_id: name
            for _, (unit_id, name) in self._files.csv_fields("measure_unit.csv", ("id", "name"))
        }
        columns = (
            "fdc_id",
            "id",
            "amount",
            "measure_unit_id",
            "portion_description",
            "modifier",
            "gram_weight",
        )
        portions: dict[str, list[Portion]] = {}
        for place, (fdc_id, portion_id, *fields) in self._files.csv_fields(
            "food_portion.csv", columns, of=self.foods
        ):
            portion = portion_of(place, portion_id, fdc_id, fields, units, self.skipped)
            if portion is not None:
                portions.setdefault(fdc_id, []).append(portion)
        return portions

    def _ndb_numbers(self) -> dict[str, str]:
        """FDC id -> NDB number, five digits at least, of Foundation and SR Legacy foods."""
        numbers: dict[str, str] = {}
        for data_type, file in NDB_FILES.items():
            if not self.has(data_type):
                continue
            for place, (fdc_id, number) in self._files.csv_fields(
                file, ("fdc_id", "NDB_number"), of=self.foods
            ):
                if number and not number.isdecimal():
                    raise place.error(f"NDB_number is {number!r}, no number")
                if number:
                    numbers[fdc_id] = number.zfill(5)
        return numbers

    def _food_codes(self) -> dict[str, tuple[str, str]]:
        """survey_fndds_food.csv: FDC id -> FNDDS food code, WWEIA category; each survey food has a row."""
        file, codes = "survey_fndds_food.csv", dict[str, tuple[str, str]]()
        if not self.has(SURVEY):
            return codes
        category = self._one_of(file, ("wweia_category_code", "wweia_category_number"))
        columns = ("fdc_id", "food_code", category)
        for place, (fdc_id, code, category_id) in self._files.csv_fields(
            file, columns, of=self.foods
        ):
            codes[place.new_key("food", fdc_id, codes)] = (code, category_id)
        for food in self.foods.values():
            if food.data_type == SURVEY and food.fdc_id not in codes:
                raise ImportFileError(
                    "food.csv", food.line, f"survey food {food.fdc_id} is none of {file}"
                )
        return codes

    def _usda_categories(self) -> dict[str, _Category]:
        """food_category.csv: id -> category, for Foundation and SR Legacy foods."""
        if not self.has(*NDB_FILES):
            return {}
        categories: dict[str, _Category] = {}
        for place, (category_id, description) in self._files.csv_fields(
            "food_category.csv", ("id", "description")
        ):
            name = place.text("description", description, MAX_GROUP)
            categories[category_id] = _Category(name, name, is_mixed=False)
        return categories

    def _wweia_categories(self) -> dict[str, _Category]:
        """wweia_food_category.csv: code -> category, for survey foods."""
        if not self.has(SURVEY):
            return {}
        file, categories = "wweia_food_category.csv", dict[str, _Category]()
        column = self._one_of(file, ("wweia_food_category", "wweia_food_category_code"))
        for place, (code, description) in self._files.csv_fields(
            file, (column, "wweia_food_category_description")
        ):
            if not code.isdecimal():
                raise place.error(f"{column} is {code!r}, no number")
            name = place.text("wweia_food_category_description", description, MAX_GROUP)
            categories[code] = _Category(
                name, group_of_category(int(code)), is_mixed_category(int(code))
            )
        return categories

    def aliases(self) -> dict[str, list[str]]:
        """food_attribute.csv, where there is one: FDC id -> common names and FNDDS's additional descriptions."""
        aliases: dict[str, list[str]] = {}
        if not (
            self._files.has("food_attribute.csv") and self._files.has("food_attribute_type.csv")
        ):
            return aliases
        types = {
            type_id
            for _, (type_id, name) in self._files.csv_fields(
                "food_attribute_type.csv", ("id", "name")
            )
            if name.lower() in ALIAS_ATTRIBUTES
        }
        columns = ("fdc_id", "food_attribute_type_id", "value")
        for _, (fdc_id, type_id, value) in self._files.csv_fields(
            "food_attribute.csv", columns, of=self.foods
        ):
            if type_id in types:
                names = (name.strip() for name in value.split(";"))
                aliases.setdefault(fdc_id, []).extend(
                    name for name in names if 0 < len(name) <= MAX_NAME
                )
        return aliases

    def _newest(self) -> dict[str, FdcFood]:
        """Of the versions of one food (by its type and NDB number or food code) the one that was published last."""
        newest: dict[tuple[str, str], FdcFood] = {}
        for food in self.foods.values():
            is_survey = food.data_type == SURVEY
            code = (
                self.food_codes[food.fdc_id][0]
                if is_survey
                else self.ndb_numbers.get(food.fdc_id, food.fdc_id)
            )
            other = newest.get((food.data_type, code))
            older, newer = (
                (None, food)
                if other is None
                else sorted((other, food), key=lambda version: version.published_on)
            )
            newest[food.data_type, code] = newer
            if older is not None:
                self.skipped.add("older versions of a food", f"{older.fdc_id} {older.name}")
        return {food.fdc_id: food for food in newest.values()}

    def _categories(self) -> dict[str, _Category]:
        """FDC id -> category."""
        by_id, by_code = self._usda_categories(), self._wweia_categories()
        none = _Category(NO_CATEGORY, NO_CATEGORY, is_mixed=False)
        categories: dict[str, _Category] = {}
        for food in self.foods.values():
            is_survey = food.data_type == SURVEY
            category_id = (self.food_codes[food.fdc_id][1] if is_survey else "") or food.category_id
            category = (by_code if is_survey else by_id).get(
                category_id, None if category_id else none
            )
            if category is None:
                file = "wweia_food_category.csv" if is_survey else "food_category.csv"
                why = f"food {food.fdc_id} is of category {category_id}, which {file} lacks"
                raise ImportFileError("food.csv", food.line, why)
            categories[food.fdc_id] = category
        return categories

    def _one_of(self, file: str, columns: tuple[str, ...]) -> str:
        """Return the one of these columns that the release has; names have changed between releases."""
        header = self._files.csv_header(file)
        for column in columns:
            if column in header:
                return column
        raise ImportFileError(
            file, 1, f"no column {' or '.join(columns)}; there are {', '.join(header)}"
        )


def read_fdc(path: Path) -> ImportedTable:
    """Read and validate the whole release.

    Raises ImportFileError, with file and line, at the first error.

    It is named fdc if it has all three data sets, otherwise after those it has (fdc-survey), so
    that one data set does not replace another.
    """
    release = FdcRelease(path)
    contents, used = release.contents()
    portions, aliases = release.portions(), release.aliases()
    starter_foods = starter_foods_by_ndb()
    foods = []
    for source in sorted(
        release.foods.values(), key=lambda food: [*DATA_TYPES].index(food.data_type)
    ):
        fdc_id = source.fdc_id
        if not contents.get(fdc_id):
            release.skipped.add("foods without any nutrient value", f"{fdc_id} {source.name}")
            continue
        food = _food(
            source, release, contents[fdc_id], portions.get(fdc_id, []), aliases.get(fdc_id, [])
        )
        starter_food = starter_foods.get(release.ndb_numbers.get(fdc_id, ""))
        # FoodData Central has no refuse
        foods.append(food if starter_food is None else replace(food, refuse=starter_food.refuse))
    version = release.date_in_name() or max(food.published_on for food in release.foods.values())
    present = [name for data_type, name in DATA_TYPES.items() if release.has(data_type)]
    name = "fdc" if len(present) == len(DATA_TYPES) else "-".join(("fdc", *present))
    medians = with_group_medians(
        foods, "USDA FoodData Central and the starter table", starter_foods
    )
    table = FoodTable(name, version.isoformat(), version, release.checksum(), medians)
    return ImportedTable(FORMAT, table, sorted_components(used), release.skipped)


def _food(
    food: FdcFood,
    release: FdcRelease,
    per_100_g: Mapping[str, float],
    portions: list[Portion],
    aliases: list[str],
) -> Food:
    category, ids = (
        release.categories[food.fdc_id],
        {"fdc_id": food.fdc_id, "fdc_data_type": food.data_type},
    )
    if food.fdc_id in release.ndb_numbers:
        ids["sr28_ndb"] = release.ndb_numbers[food.fdc_id]
    if food.fdc_id in release.food_codes:
        ids["fndds"] = release.food_codes[food.fdc_id][0]
    form = usual_form(food.name, category.form_group)
    # FNDDS describes foods as eaten, including those with "raw" in their names.
    state: FoodState = "as_eaten" if food.data_type == SURVEY else usual_state(food.name)
    densities = portion_densities(
        portions,
        form,
        state,
        f"USDA FDC {food.fdc_id}",
        cup_kind=cup_kind(food.name, category.form_group, form),
    )
    return Food(
        key=f"fdc:{food.fdc_id}",
        name=food.name,
        aliases=tuple(dict.fromkeys(aliases)),
        food_group=category.name,
        form=form,
        densities=(*densities, *kind_density(food.name, category.form_group, form)),
        per_100_g=MappingProxyType(per_100_g),
        source_ids=ids,
        state=state,
        is_mixed_dish=category.is_mixed or is_mixed_dish(food.name, category.name),
        portions=tuple(portions),
    )
