"""FoodData Central's CSV release, zip or folder, whole or one of its data sets -> its table, checked.

Taken are Foundation, SR Legacy and Survey (FNDDS) foods; branded foods and laboratory samples are counted. The whole
release has more than twenty million nutrient values, nearly all of branded foods: files are streamed, and only what
belongs to wanted foods is kept.
Columns as in the releases of 2020 to 2026; FNDDS names its nutrients by number (208), the others by id (1008).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from types import MappingProxyType

from app.foods.importers.fdc_portions import portion_of
from app.foods.importers.imported import (
    MAX_GROUP,
    MAX_NAME,
    ImportedTable,
    Skipped,
    SourceComponent,
    sorted_components,
    source_component,
    unit_of,
)
from app.foods.importers.source_files import ImportFileError, SourceFiles
from app.foods.importers.wweia import group_of_category, is_mixed_category
from app.nutrition.components import Component
from app.nutrition.foods import Food, FoodForm, FoodState, FoodTable, RefusePart
from app.nutrition.group_density import starter_foods_by_ndb, with_group_medians
from app.nutrition.kind_density import kind_density
from app.nutrition.portion_density import portion_densities
from app.nutrition.portions import Portion
from app.nutrition.usual_form import cup_kind, is_mixed_dish, usual_form, usual_state

FORMAT = "fdc"

# In the order of their worth: analysed foods first. The second word is the data set's part of a release's name.
DATA_TYPES = {"foundation_food": "foundation", "sr_legacy_food": "sr-legacy", "survey_fndds_food": "survey"}
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
    """A food of food.csv that is wanted. line: in that file."""

    fdc_id: str
    data_type: str
    name: str
    category_id: str
    published_on: date
    line: int


@dataclass(frozen=True, slots=True)
class _Category:
    """What a food's category says: its name, the group whose words judge its form, whether its foods are dishes."""

    name: str
    form_group: str
    is_mixed: bool


class FdcRelease:
    """The release at a path. Each method streams one file and checks it. Raises ImportFileError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._files = SourceFiles(path)
        self._files.require(ALWAYS)

    def checksum(self) -> str:
        """SHA-256 of what is read of it, hex."""
        return self._files.checksum((*ALWAYS, *OPTIONAL))

    def date_in_name(self) -> date | None:
        """The release's date, where the name of the zip or folder tells it: FoodData_Central_csv_2025-04-24.zip."""
        found = _DATE.search(self._path.name)
        return None if found is None else date.fromisoformat(found[0])

    def foods(self, skipped: Skipped) -> dict[str, FdcFood]:
        """food.csv: FDC id -> food, for the data types that are taken."""
        file, foods = "food.csv", dict[str, FdcFood]()
        columns = ("fdc_id", "data_type", "description", "food_category_id", "publication_date")
        for place, (fdc_id, data_type, description, category_id, published) in self._files.csv_fields(file, columns):
            if data_type not in DATA_TYPES:
                skipped.add(f"foods of the type {data_type}", f"{fdc_id} {description}")
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

    def components(self, skipped: Skipped) -> dict[str, SourceComponent | None]:
        """nutrient.csv: id and number -> component; None for what no unit here measures (pH, specific gravity ...)."""
        file, by_id, by_number = (
            "nutrient.csv",
            dict[str, SourceComponent | None](),
            dict[str, SourceComponent | None](),
        )
        columns = ("id", "name", "unit_name", "nutrient_nbr")
        for place, (nutrient_id, name, unit, raw_number) in self._files.csv_fields(file, columns):
            place.new_key("nutrient", nutrient_id, by_id)
            number = raw_number.removesuffix(".0")
            if not number:
                skipped.add("nutrients without a number", f"{nutrient_id} {name}")
                by_id[nutrient_id] = None
            elif unit_of(unit) is None:
                skipped.add(f"nutrients in {unit}", f"{number} {name}")
                by_id[nutrient_id] = by_number[number] = None
            else:
                by_id[nutrient_id] = source_component(place, number, name[:200], unit)
                by_number.setdefault(number, by_id[nutrient_id])
        return {**by_number, **by_id}  # ids run from 1001, numbers stay below 1000

    def contents(
        self, foods: Mapping[str, FdcFood], components: Mapping[str, SourceComponent | None], skipped: Skipped
    ) -> tuple[_Contents, dict[str, Component]]:
        """food_nutrient.csv: FDC id -> component number -> content of 100 g; and the components that occur."""
        file, contents, used = "food_nutrient.csv", _Contents(), dict[str, Component]()
        contradicted: set[tuple[str, str]] = set()
        columns = ("fdc_id", "nutrient_id", "amount")
        for place, (fdc_id, nutrient_id, amount) in self._files.csv_fields(file, columns, of=foods):
            if nutrient_id not in components:
                raise place.error(f"nutrient {nutrient_id} of food {fdc_id} is none of nutrient.csv")
            found = components[nutrient_id]
            if found is None:
                skipped.add("values of nutrients that are left out", f"{fdc_id} {nutrient_id}")
                continue
            number = found.component.number
            what = f"{fdc_id} {number} {found.component.name}"
            if not amount:
                skipped.add("values without an amount", what)
                continue
            if amount.startswith("-"):
                place.number(f"nutrient {nutrient_id}", amount[1:])
                skipped.add("values below zero (by difference)", what)
                continue
            value = place.number(f"nutrient {nutrient_id}", amount) * found.factor
            if contents.setdefault(fdc_id, {}).setdefault(number, value) != value:
                contradicted.add((fdc_id, number))
            used[number] = found.component
        for fdc_id, number in sorted(contradicted):
            del contents[fdc_id][number]
            skipped.add("values that are given twice and differ", f"{fdc_id} {number}")
        return contents, used

    def portions(self, foods: Mapping[str, FdcFood], skipped: Skipped) -> dict[str, list[Portion]]:
        """food_portion.csv: FDC id -> its household measures, in the file's order."""
        units = {unit_id: name for _, (unit_id, name) in self._files.csv_fields("measure_unit.csv", ("id", "name"))}
        columns = ("fdc_id", "id", "amount", "measure_unit_id", "portion_description", "modifier", "gram_weight")
        portions: dict[str, list[Portion]] = {}
        for place, (fdc_id, portion_id, *fields) in self._files.csv_fields("food_portion.csv", columns, of=foods):
            portion = portion_of(place, portion_id, fdc_id, fields, units, skipped)
            if portion is not None:
                portions.setdefault(fdc_id, []).append(portion)
        return portions

    def ndb_numbers(self, foods: Mapping[str, FdcFood]) -> dict[str, str]:
        """FDC id -> NDB number, five digits at least, of Foundation and SR Legacy foods."""
        numbers: dict[str, str] = {}
        for data_type, file in NDB_FILES.items():
            if not any(food.data_type == data_type for food in foods.values()):
                continue
            for place, (fdc_id, number) in self._files.csv_fields(file, ("fdc_id", "NDB_number"), of=foods):
                if number and not number.isdecimal():
                    raise place.error(f"NDB_number is {number!r}, no number")
                if number:
                    numbers[fdc_id] = number.zfill(5)
        return numbers

    def food_codes(self, foods: Mapping[str, FdcFood]) -> dict[str, tuple[str, str]]:
        """survey_fndds_food.csv: FDC id -> FNDDS food code, WWEIA category; each survey food has a row."""
        file, codes = "survey_fndds_food.csv", dict[str, tuple[str, str]]()
        wanted = [food for food in foods.values() if food.data_type == SURVEY]
        if not wanted:
            return codes
        category = self._one_of(file, ("wweia_category_code", "wweia_category_number"))
        columns = ("fdc_id", "food_code", category)
        for place, (fdc_id, code, category_id) in self._files.csv_fields(file, columns, of=foods):
            codes[place.new_key("food", fdc_id, codes)] = (code, category_id)
        for food in wanted:
            if food.fdc_id not in codes:
                raise ImportFileError("food.csv", food.line, f"survey food {food.fdc_id} is none of {file}")
        return codes

    def categories(self, foods: Mapping[str, FdcFood]) -> dict[str, _Category]:
        """food_category.csv: id -> category, for Foundation and SR Legacy foods."""
        if all(food.data_type == SURVEY for food in foods.values()):
            return {}
        categories: dict[str, _Category] = {}
        for place, (category_id, description) in self._files.csv_fields("food_category.csv", ("id", "description")):
            name = place.text("description", description, MAX_GROUP)
            categories[category_id] = _Category(name, name, is_mixed=False)
        return categories

    def wweia_categories(self, foods: Mapping[str, FdcFood]) -> dict[str, _Category]:
        """wweia_food_category.csv: code -> category, for survey foods."""
        if not any(food.data_type == SURVEY for food in foods.values()):
            return {}
        file, categories = "wweia_food_category.csv", dict[str, _Category]()
        column = self._one_of(file, ("wweia_food_category", "wweia_food_category_code"))
        for place, (code, description) in self._files.csv_fields(file, (column, "wweia_food_category_description")):
            if not code.isdecimal():
                raise place.error(f"{column} is {code!r}, no number")
            name = place.text("wweia_food_category_description", description, MAX_GROUP)
            categories[code] = _Category(name, group_of_category(int(code)), is_mixed_category(int(code)))
        return categories

    def aliases(self, foods: Mapping[str, FdcFood]) -> dict[str, list[str]]:
        """food_attribute.csv, where there is one: FDC id -> common names and FNDDS's additional descriptions."""
        aliases: dict[str, list[str]] = {}
        if not (self._files.has("food_attribute.csv") and self._files.has("food_attribute_type.csv")):
            return aliases
        types = {
            type_id
            for _, (type_id, name) in self._files.csv_fields("food_attribute_type.csv", ("id", "name"))
            if name.lower() in ALIAS_ATTRIBUTES
        }
        columns = ("fdc_id", "food_attribute_type_id", "value")
        for _, (fdc_id, type_id, value) in self._files.csv_fields("food_attribute.csv", columns, of=foods):
            if type_id in types:
                names = (name.strip() for name in value.split(";"))
                aliases.setdefault(fdc_id, []).extend(name for name in names if 0 < len(name) <= MAX_NAME)
        return aliases

    def _one_of(self, file: str, columns: tuple[str, ...]) -> str:
        """The one of these columns that the release calls it by: the names have changed."""
        header = self._files.csv_header(file)
        for column in columns:
            if column in header:
                return column
        raise ImportFileError(file, 1, f"no column {' or '.join(columns)}; there are {', '.join(header)}")


def read_fdc(path: Path) -> ImportedTable:
    """The release, checked whole. Raises ImportFileError, with file and line, at the first thing that is wrong.

    Named fdc if all three data sets are in it, else by those that are (fdc-survey), so that one downloaded alone does
    not take the place of another.
    """
    release, skipped = FdcRelease(path), Skipped()
    foods = release.foods(skipped)
    ndb_numbers, food_codes = release.ndb_numbers(foods), release.food_codes(foods)
    foods = _newest(foods, ndb_numbers, food_codes, skipped)
    categories = _categories_of_foods(release, foods, food_codes)
    contents, used = release.contents(foods, release.components(skipped), skipped)
    portions, aliases = release.portions(foods, skipped), release.aliases(foods)
    starter_foods = starter_foods_by_ndb()
    whole = []
    for food in sorted(foods.values(), key=lambda one: [*DATA_TYPES].index(one.data_type)):
        if not contents.get(food.fdc_id):
            skipped.add("foods without any nutrient value", f"{food.fdc_id} {food.name}")
            continue
        category, ndb_number = categories[food.fdc_id], ndb_numbers.get(food.fdc_id)
        whole.append(
            _food(
                food,
                category,
                MappingProxyType(contents[food.fdc_id]),
                portions.get(food.fdc_id, []),
                aliases.get(food.fdc_id, []),
                _source_ids(food, ndb_number, food_codes.get(food.fdc_id)),
                starter_foods.get(ndb_number or ""),
            )
        )
    version = release.date_in_name() or max(food.published_on for food in foods.values())
    present = [name for data_type, name in DATA_TYPES.items() if any(f.data_type == data_type for f in foods.values())]
    name = "fdc" if len(present) == len(DATA_TYPES) else "-".join(("fdc", *present))
    medians = with_group_medians(whole, "USDA FoodData Central and the starter table", starter_foods)
    table = FoodTable(name, version.isoformat(), version, release.checksum(), medians)
    return ImportedTable(FORMAT, table, sorted_components(used), skipped)


def _newest(
    foods: Mapping[str, FdcFood],
    ndb_numbers: Mapping[str, str],
    food_codes: Mapping[str, tuple[str, str]],
    skipped: Skipped,
) -> dict[str, FdcFood]:
    """Of the versions of one food (by its type and NDB number or food code) the one that was published last."""
    newest: dict[tuple[str, str], FdcFood] = {}
    for food in foods.values():
        code = food_codes[food.fdc_id][0] if food.data_type == SURVEY else ndb_numbers.get(food.fdc_id, food.fdc_id)
        other = newest.get((food.data_type, code))
        older, newer = (None, food) if other is None else sorted((other, food), key=lambda one: one.published_on)
        newest[food.data_type, code] = newer
        if older is not None:
            skipped.add("older versions of a food", f"{older.fdc_id} {older.name}")
    return {food.fdc_id: food for food in newest.values()}


def _categories_of_foods(
    release: FdcRelease, foods: Mapping[str, FdcFood], food_codes: Mapping[str, tuple[str, str]]
) -> dict[str, _Category]:
    by_id, by_code = release.categories(foods), release.wweia_categories(foods)
    none = _Category(NO_CATEGORY, NO_CATEGORY, is_mixed=False)
    found: dict[str, _Category] = {}
    for food in foods.values():
        is_survey = food.data_type == SURVEY
        category_id = (food_codes[food.fdc_id][1] if is_survey else "") or food.category_id
        category = (by_code if is_survey else by_id).get(category_id, None if category_id else none)
        if category is None:
            file = "wweia_food_category.csv" if is_survey else "food_category.csv"
            why = f"food {food.fdc_id} is of category {category_id}, which {file} lacks"
            raise ImportFileError("food.csv", food.line, why)
        found[food.fdc_id] = category
    return found


def _food(
    food: FdcFood,
    category: _Category,
    per_100_g: Mapping[str, float],
    portions: list[Portion],
    aliases: list[str],
    source_ids: Mapping[str, str],
    starter_food: Food | None,
) -> Food:
    form: FoodForm = usual_form(food.name, category.form_group)
    # FNDDS codes foods as they are eaten; "raw" in its names is how they are eaten then.
    state: FoodState = "as_eaten" if food.data_type == SURVEY else usual_state(food.name)
    refuse: tuple[RefusePart, ...] = () if starter_food is None else starter_food.refuse  # FoodData Central has none
    densities = portion_densities(
        portions, form, state, f"USDA FDC {food.fdc_id}", cup_kind=cup_kind(food.name, category.form_group, form)
    )
    return Food(
        key=f"fdc:{food.fdc_id}",
        name=food.name,
        aliases=tuple(dict.fromkeys(aliases)),
        food_group=category.name,
        form=form,
        refuse=refuse,
        densities=(*densities, *kind_density(food.name, category.form_group, form)),
        per_100_g=per_100_g,
        source_ids=source_ids,
        state=state,
        is_mixed_dish=category.is_mixed or is_mixed_dish(food.name, category.name),
        portions=tuple(portions),
    )


def _source_ids(food: FdcFood, ndb_number: str | None, codes: tuple[str, str] | None) -> dict[str, str]:
    ids = {"fdc_id": food.fdc_id, "fdc_data_type": food.data_type}
    if ndb_number is not None:
        ids["sr28_ndb"] = ndb_number
    if codes is not None:
        ids["fndds"] = codes[0]
    return ids
