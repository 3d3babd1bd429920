"""FoodData Central's layout on a small release of our own: three data sets, three dialects, and what is refused."""

import csv
import datetime as dt
import io

import pytest

from app.foods.importers.fdc import read_fdc
from app.foods.importers.source_files import ImportFileError
from tests.unit.foods.importers.release_files import replaced, write_folder, write_zip

CUP_ML = 236.5882365


def table(header, *rows):
    """Every field quoted, as published."""
    text = io.StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_ALL, lineterminator="\n")
    writer.writerows([header.split(","), *rows])
    return text.getvalue()


NUTRIENT_HEADER = (
    "id,fdc_id,nutrient_id,amount,data_points,derivation_id,min,max,median,loq,footnote,min_year_acquired,"
    "percent_daily_value"
)
PORTION_HEADER = (
    "id,fdc_id,seq_num,amount,measure_unit_id,portion_description,modifier,gram_weight,data_points,footnote,"
    "min_year_acquired"
)


def values(*rows):
    return table(NUTRIENT_HEADER, *((str(n), *row, *[""] * 9) for n, row in enumerate(rows, start=1)))


def portions(*rows):
    return table(PORTION_HEADER, *((str(n), row[0], "1", *row[1:], "", "", "") for n, row in enumerate(rows, start=1)))


FILES = {
    "food.csv": table(
        "fdc_id,data_type,description,food_category_id,publication_date",
        ("171688", "sr_legacy_food", "Apples, raw, with skin", "9", "2019-04-01"),
        ("1750340", "foundation_food", "Apples, fuji, with skin, raw", "9", "2020-10-30"),
        ("2709223", "survey_fndds_food", "Beef stew with potatoes", "3002", "2024-10-31"),
        ("2705385", "survey_fndds_food", "Milk, whole", "1002", "2024-10-31"),
        ("1105904", "branded_food", 'OIL, "PURE", \u00e9', "Oils Edible", "2020-11-13"),
        ("319874", "sample_food", "HUMMUS, SABRA CLASSIC", "16", "2019-04-01"),
    ),
    "food_category.csv": table("id,code,description", ("9", "0900", "Fruits and Fruit Juices")),
    "nutrient.csv": table(
        "id,name,unit_name,nutrient_nbr,rank",
        ("1003", "Protein", "G", "203", "600.0"),
        ("1005", "Carbohydrate, by difference", "G", "205", "1110.0"),
        ("1008", "Energy", "KCAL", "208", "300.0"),
        ("1062", "Energy", "kJ", "268", "400.0"),
        ("1050", "Carbohydrate, by summation", "G", "205.2", "1120.0"),
        ("1024", "Specific Gravity", "SP_GR", "227", "999999.0"),
        ("1103", "Selenium, Se", "UG", "317", "6200.0"),
        ("2047", "Energy (Atwater General Factors)", "KCAL", "957", "280.0"),
        ("2048", "Energy (Atwater Specific Factors)", "KCAL", "958", "290.0"),
        ("2057", "Ergothioneine", "MG", "", "20500.0"),
        ("1234", "Taurine", "G", "529", "17900.0"),
    ),
    "food_nutrient.csv": values(
        ("171688", "1008", "52"),
        ("171688", "1005", "13.81"),
        ("171688", "1062", "218"),
        ("1750340", "2047", "64.7"),
        ("1750340", "2048", "58.3"),
        ("1750340", "1050", "13.2"),
        ("1750340", "1024", "1.05"),
        ("1750340", "2057", "0.1"),
        ("1750340", "1234", ""),
        ("1750340", "1005", "-0.4"),
        ("2709223", "208", "99"),
        ("2709223", "203", "8.1"),
        ("2705385", "208", "60"),
        ("2705385", "529", "0"),
        ("1105904", "9999", "no matter"),
    ),
    "measure_unit.csv": table(
        "id,name", ("1000", "cup"), ("1010", "paired cooked w"), ("1119", "Banana"), ("9999", "undetermined")
    ),
    "food_portion.csv": portions(
        ("171688", "1.0", "9999", "", "cup, quartered or chopped", "125.0"),
        ("1750340", "0.5", "1000", "", "sliced", "54.5"),
        ("1750340", "1", "1010", "", "", "70"),
        ("1750340", "1", "1119", "", "Unpeeled", "130"),
        ("2709223", "", "9999", "1 cup", "10205", "245"),
        ("2709223", "", "9999", "Quantity not specified", "90000", "245"),
        ("2705385", "", "9999", "1/2 fl oz (no ice)", "30001", "15.25"),
        ("2705385", "", "9999", "1 1/2 school carton", "61000", "366"),
        ("2705385", "", "9999", "Guideline amount per cereal", "61000", "12"),
        ("1105904", "1", "5555", "", "", "28"),
    ),
    "sr_legacy_food.csv": table("fdc_id,NDB_number", ("171688", "9003")),
    "foundation_food.csv": table("fdc_id,NDB_number,footnote", ("1750340", "9504", "")),
    "survey_fndds_food.csv": table(
        "fdc_id,food_code,wweia_category_code,start_date,end_date",
        ("2709223", "27311310", "3002", "2021-01-01", "2023-12-31"),
        ("2705385", "11111000", "1002", "2021-01-01", "2023-12-31"),
    ),
    "wweia_food_category.csv": table(
        "wweia_food_category,wweia_food_category_description", ("1002", "Milk, whole"), ("3002", "Meat mixed dishes")
    ),
    "food_attribute_type.csv": table("id,name,description", ("1001", "Additional Description", ""), ("999", "X", "")),
    "food_attribute.csv": table(
        "id,fdc_id,seq_num,food_attribute_type_id,name,value",
        ("1", "2705385", "1", "1001", "", "leche fresca; whole milk"),
        ("2", "2705385", "2", "999", "Update", "2024"),
        ("3", "1105904", "1", "1001", "", "no matter"),
    ),
}


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """The small release."""
    return read(tmp_path_factory.mktemp("fdc"))


@pytest.fixture(scope="module")
def found(imported):
    return foods(imported)


def read(tmp_path, folder="FoodData_Central_csv_2025-04-24", **changed):
    """The small release with some of its files changed: name without .csv -> function of the text."""
    files = {name: changed.get(name[:-4], lambda text: text)(text) for name, text in FILES.items()}
    return read_fdc(write_folder(tmp_path / folder, {name: text for name, text in files.items() if text is not None}))


def foods(imported):
    return {food.key: food for food in imported.table.foods}


def test_zip_and_folder_give_the_same_table_named_by_its_date_or_that_of_its_newest_food(imported, tmp_path):
    path = tmp_path / "FoodData_Central_csv_2025-04-24.zip"
    assert read_fdc(write_zip(path, FILES, inside="FoodData_Central_csv_2025-04-24/")).table == imported.table
    assert (imported.table.name, imported.table.version) == ("fdc", "2025-04-24")
    assert imported.table.released_on == dt.date(2025, 4, 24)
    assert read(tmp_path, folder="download").table.released_on == dt.date(2024, 10, 31)


def test_foundation_foods_come_before_sr_legacy_and_these_before_survey_foods_and_ids_meet_those_of_sr28(found):
    assert [*found] == ["fdc:1750340", "fdc:171688", "fdc:2709223", "fdc:2705385"]
    apple_ids = {"fdc_id": "171688", "fdc_data_type": "sr_legacy_food", "sr28_ndb": "09003"}
    assert found["fdc:171688"].source_ids == apple_ids
    assert found["fdc:1750340"].source_ids["sr28_ndb"] == "09504"
    assert found["fdc:2709223"].source_ids["fndds"] == "27311310"


def test_nutrients_are_keyed_by_their_own_number_whether_named_by_id_or_as_fndds_does_by_number(imported, found):
    assert found["fdc:171688"].per_100_g == {"208": 52.0, "205": 13.81, "268": 218.0}
    assert found["fdc:1750340"].per_100_g == {"957": 64.7, "958": 58.3, "205.2": 13.2}
    assert found["fdc:2709223"].per_100_g == {"208": 99.0, "203": 8.1}
    assert found["fdc:2705385"].per_100_g == {"208": 60.0, "529": 0.0}
    numbers = {component.number for component in imported.components}
    assert numbers == {"203", "205", "205.2", "208", "268", "529", "957", "958"}


def test_each_data_sets_way_to_say_a_portion_is_understood(found):
    assert [(p.amount, p.measure, p.mass_g) for food in found.values() for p in food.portions] == [
        (0.5, "cup, sliced", 54.5),
        (1.0, "cup, quartered or chopped", 125.0),
        (1.0, "cup", 245.0),
        (0.5, "fl oz (no ice)", 15.25),
        (1.5, "school carton", 366.0),
    ]
    (sliced,) = found["fdc:1750340"].densities
    assert (sliced.kind, sliced.state, sliced.g_per_ml) == ("bulk", "sliced", pytest.approx(109 / CUP_ML, abs=5e-4))
    (milk,) = found["fdc:2705385"].densities
    assert (milk.kind, milk.g_per_ml) == ("solid", pytest.approx(30.5 / (CUP_ML / 8), abs=5e-4))


def test_survey_foods_are_as_eaten_their_dishes_are_known_by_category_and_the_apples_core_by_the_packaged_table(found):
    stew, milk, apple = found["fdc:2709223"], found["fdc:2705385"], found["fdc:171688"]
    assert (stew.is_mixed_dish, stew.state, stew.form) == (True, "as_eaten", "heap")
    assert stew.food_group == "Meat mixed dishes"
    assert (milk.is_mixed_dish, milk.state, milk.form) == (False, "as_eaten", "liquid")
    assert milk.aliases == ("leche fresca", "whole milk")
    assert (apple.is_mixed_dish, apple.state, apple.form) == (False, "raw", "whole")
    assert [part.part for part in apple.refuse] == ["core and stem"]


def test_everything_left_out_is_counted_with_its_reason(imported):
    assert set(imported.skipped.sentences()) == {
        '1 foods of the type branded_food (1105904 OIL, "PURE", \u00e9)',
        "1 foods of the type sample_food (319874 HUMMUS, SABRA CLASSIC)",
        "1 nutrients in SP_GR (227 Specific Gravity)",
        "1 nutrients without a number (2057 Ergothioneine)",
        "2 values of nutrients that are left out (1750340 1024, 1750340 2057)",
        "1 values without an amount (1750340 529 Taurine)",
        "1 values below zero (by difference) (1750340 205 Carbohydrate, by difference)",
        "1 portions that only the laboratory weighed (1750340 paired cooked w)",
        "1 portions that hold waste (1750340 Unpeeled)",
        "1 portions of a quantity that is not specified (2709223 Quantity not specified)",
        "1 portions without an amount, a measure or a weight (2705385 Guideline amount per cereal)",
    }


def more(text):
    return lambda before: before + text


def test_two_different_values_are_none_and_of_two_versions_of_a_food_the_newer_counts(tmp_path):
    imported = read(
        tmp_path, food_nutrient=more(values(("171688", "1008", "52"), ("171688", "1005", "9")).split("\n", 1)[1])
    )
    assert foods(imported)["fdc:171688"].per_100_g == {"208": 52.0, "268": 218.0}
    assert "1 values that are given twice and differ (171688 205)" in set(imported.skipped.sentences())
    old = '"100","survey_fndds_food","Milk, cow","1002","2020-10-30"\n'
    imported = read(
        tmp_path, food=more(old), survey_fndds_food=more('"100","11111000","1002","2017-01-01","2018-12-31"\n')
    )
    assert "fdc:100" not in foods(imported)
    assert "1 older versions of a food (100 Milk, cow)" in set(imported.skipped.sentences())


@pytest.mark.parametrize(
    ("kind", "files", "name"),
    [
        ("survey_fndds_food", {"survey_fndds_food", "wweia_food_category"}, "fdc-survey"),
        ("sr_legacy_food", {"sr_legacy_food", "food_category"}, "fdc-sr-legacy"),
        ("foundation_food", {"foundation_food", "food_category"}, "fdc-foundation"),
    ],
)
def test_data_set_downloaded_alone_is_a_release_of_its_own(tmp_path, kind, files, name):
    others = set(FILES) - {
        f"{file}.csv" for file in files | {"food", "nutrient", "food_nutrient", "food_portion", "measure_unit"}
    }
    changed = {other[:-4]: lambda text: None for other in others}

    def food(text):
        return "".join(line for n, line in enumerate(text.splitlines(keepends=True)) if n == 0 or kind in line)

    assert read(tmp_path, food=food, **changed).table.name == name


def test_columns_that_were_renamed_between_releases_are_both_known(tmp_path):
    imported = read(
        tmp_path,
        survey_fndds_food=replaced("wweia_category_code", "wweia_category_number"),
        wweia_food_category=replaced('"wweia_food_category"', '"wweia_food_category_code"'),
    )
    assert foods(imported)["fdc:2705385"].food_group == "Milk, whole"


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("food", replaced("2019-04-01", "4/1/2019"), r"food.csv, line 2: publication_date is '4/1/2019', no date"),
        ("food", replaced("1750340", "171688"), r"food.csv, line 3: food 171688 is there twice"),
        ("food", replaced("Milk, whole", ""), r"food.csv, line 5: description is empty"),
        ("food", replaced('"9","2019', '"8","2019'), r"food.csv, line 2: food 171688 is of category 8, which food_cat"),
        ("food", lambda text: text.replace('food"', 'fodder"'), r"food.csv: it holds no food of foundation_food"),
        ("nutrient", replaced("KCAL", "G"), r"nutrient.csv, line 4: component 208 \(Energy\) .* does not fit kcal"),
        ("food_nutrient", replaced('"13.81"', '"13,81"'), r"food_nutrient.csv, line 3: nutrient 1005 is '13,81', no"),
        ("food_nutrient", replaced('"1062"', '"7777"'), r"food_nutrient.csv, line 4: nutrient 7777 of food 171688 is"),
        ("wweia_food_category", replaced('"1002"', '"x"'), r"wweia_food_category.csv, line 2: .* is 'x', no number"),
        ("food_portion", replaced('"125.0"', '"heavy"'), r"food_portion.csv, line 2: gram_weight is 'heavy', no"),
        ("food_portion", replaced('"1000"', '"1234"'), r"food_portion.csv, line 3: measure unit 1234 is none of"),
        ("food_portion", replaced('"0.5"', '"-1"'), r"food_portion.csv, line 3: amount is -1, which cannot be"),
        ("survey_fndds_food", replaced("2705385", "1"), r"food.csv, line 5: survey food 2705385 is none of"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_file_and_line(tmp_path, file, change, message):
    with pytest.raises(ImportFileError, match=message):
        read(tmp_path, **{file: change})
