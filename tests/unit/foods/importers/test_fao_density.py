"""The FAO/INFOODS workbook: rows, what their names and headings tell, what is left out, other workbooks."""

import openpyxl
import pytest

from app.foods.importers.fao_density import WATER_G_PER_ML, read_fao_density, read_fao_rows
from app.foods.importers.source_files import ImportFileError
from tests.unit.foods.importers.release_files import damage_member

HEADER = (
    "Food name and description",
    "Density in g/ml (including mass and bulk density)",
    "Specific gravity",
    "BiblioID",
)
ROWS = [
    HEADER,
    ("Beverages, alcoholic", None, None, None),
    ("Beer", None, None, None),
    ("Beer, lager", None, 1.005, "UK 6th"),
    ("Wine, table, red", 0.992, 0.994, "USDA"),
    ("Milk ", None, None, None),
    ("Milk (powdered whole)", 0.56, None, "FNDDS 4.1"),
    ("Cereal and cereal products", None, None, None),
    ("Rice, boiled", 0.73, None, "KEN"),
    ("Kidney beans, dry, boiled", 0.79, None, "KEN"),
    ("Oats", 0.41, None, "TB"),
    ("Bran", "0.2-0.3", None, "ASI"),
    ("Biscuits", "0.41-0.53", None, "FNDDS 4.1"),
    ("Bread", 0.29, None, "FNDDS 4.1"),
    ("Breakfast cereal, muesli", "0.30-0.44", None, "DK"),
    ("Fruits", None, None, None),
    ("Loquat", 0.6, None, "KEN"),
    ("Vegetables", None, None, None),
    ("Spinach, leaves,  raw", 0.08, None, "RC"),
    ("French green beans", 0.53, None, "KEN"),
    ("Miscellaneous foods", None, None, None),
    ("Salt, sodium chloride", 2.165, None, "TB"),
    (None, None, None, None),
]


def write_workbook(path, rows, sheet="Density DB"):
    workbook = openpyxl.Workbook()
    workbook.active.title = sheet
    for row in rows:
        workbook.active.append(row)
    workbook.save(path)
    workbook.close()
    return path


@pytest.fixture
def workbook(tmp_path):
    return write_workbook(tmp_path / "fao.xlsx", ROWS)


def test_rows_keep_number_and_heading_and_turn_ranges_and_gravities_into_densities(workbook):
    rows = read_fao_rows(workbook)
    assert (rows[9].name, rows[9].section, rows[9].biblio_id) == ("Rice, boiled", "Cereal and cereal products", "KEN")
    assert (rows[12].g_per_ml, rows[12].half_range_g_per_ml) == (pytest.approx(0.25), pytest.approx(0.05))
    assert rows[4].g_per_ml == pytest.approx(1.005 * WATER_G_PER_ML)
    assert rows[5].g_per_ml == 0.992
    assert rows[19].name == "Spinach, leaves, raw"


def test_kind_state_and_spread_follow_the_heading_and_the_words(workbook):
    imported = read_fao_density(workbook)
    foods = {food.name: (food, food.densities[0]) for food in imported.table.foods}
    assert {name: (density.kind, food.form, food.state) for name, (food, density) in foods.items()} == {
        "Beer, lager": ("solid", "liquid", "as_eaten"),
        "Wine, table, red": ("solid", "liquid", "as_eaten"),
        "Milk (powdered whole)": ("bulk", "heap", "as_eaten"),
        "Rice, boiled": ("bulk", "heap", "cooked"),
        "Kidney beans, dry, boiled": ("bulk", "heap", "cooked"),
        "Oats": ("bulk", "heap", "raw"),
        "Bread": ("solid", "slab", "as_eaten"),
        "Breakfast cereal, muesli": ("bulk", "heap", "as_eaten"),
        "Spinach, leaves, raw": ("bulk", "heap", "raw"),
        "French green beans": ("bulk", "heap", None),
    }
    rice, density = foods["Rice, boiled"]
    assert (density.basis, density.g_per_ml, density.sd_g_per_ml) == ("fao", 0.73, pytest.approx(0.12 * 0.73, abs=1e-3))
    assert density.source == 'FAO/INFOODS 2012, Density Database 2.0, row 9 "Rice, boiled" (KEN)'
    assert (rice.key, rice.per_100_g, imported.components) == ("fao:9", {}, ())
    assert foods["Bread"][1].relative_sd == pytest.approx(0.2, abs=0.01)
    assert foods["Spinach, leaves, raw"][1].relative_sd == pytest.approx(0.4, abs=0.01)
    assert foods["Breakfast cereal, muesli"][1].sd_g_per_ml == pytest.approx(0.07)  # never less than a published range
    assert set(imported.skipped.sentences()) == {
        "2 rows that do not say whether a piece or a heap was weighed (13 Biscuits, 17 Loquat)",
        "1 rows of ASI, which weighs goods in silos (12 Bran)",
        "1 rows of a crystal, not of the food that is poured (22 Salt, sodium chloride)",
    }


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([("Food", "kcal", "g", "ID")], r"fao.xlsx, line 1: the columns are food, kcal, g, id; expected: food name"),
        ([HEADER, ("Rice", "much", None, "KEN")], r"fao.xlsx, line 2: 'much' is neither a density nor a range"),
        ([HEADER, ("Rice", 0, None, "KEN")], r"fao.xlsx, line 2: the density of Rice is 0"),
        ([HEADER, ("Rice", None, -1, "KEN")], r"fao.xlsx, line 2: -1 is neither"),
        ([], r"fao.xlsx, line 1: the columns are"),
    ],
)
def test_sheet_that_is_another_is_refused_with_its_line(tmp_path, rows, message):
    with pytest.raises(ImportFileError, match=message):
        read_fao_density(write_workbook(tmp_path / "fao.xlsx", rows))
    with pytest.raises(ImportFileError, match=r"other.xlsx: it has no sheet 'Density DB'"):
        read_fao_density(write_workbook(tmp_path / "other.xlsx", rows, sheet="Sheet"))


def test_missing_truncated_damaged_and_old_workbooks_are_refused(tmp_path, workbook):
    raw = workbook.read_bytes()
    truncated, old, text = tmp_path / "truncated.xlsx", tmp_path / "density.xls", tmp_path / "table.csv"
    truncated.write_bytes(raw[:-200])
    old.write_bytes(bytes.fromhex("d0cf11e0a1b11ae1") + bytes(2000))
    text.write_text("Food name,Density\nRice,0.73\n")
    damage_member(workbook, "sheet1.xml")
    for path in (truncated, old, text, workbook):
        with pytest.raises(ImportFileError, match=rf"{path.name}: it is no Excel workbook"):
            read_fao_density(path)
    with pytest.raises(ImportFileError, match=r"nowhere.xlsx: there is no such file"):
        read_fao_density(tmp_path / "nowhere.xlsx")


def test_published_workbook_is_read_whole(shared_data):
    imported = read_fao_density(shared_data / "food_tables" / "fao_infoods_density_v2.xlsx")
    assert len(imported.table.foods) + imported.skipped.counts.total() == 638  # rows with a figure
    assert imported.skipped.counts["rows of ASI, which weighs goods in silos"] == 137
    assert imported.table.food("fao:364").densities[0].g_per_ml == 0.73
    assert all(0.05 <= food.densities[0].g_per_ml <= 1.5 for food in imported.table.foods)
