"""Readers of the published formats, on small files of our own."""

import zipfile

import openpyxl
import pytest

from app.nutrition.importers.ecustfd import Specimen, measured_density, read_measured, write_measured
from app.nutrition.importers.fao_density import WATER_G_PER_ML, read_fao_rows
from app.nutrition.importers.sr28 import Sr28Release, parse_refuse
from app.units import Unit

SR28_FILES = {
    "FD_GROUP.txt": "~0900~^~Fruits~\r\n",
    "NUTR_DEF.txt": "~317~^~\u00b5g~^~SE~^~Selenium, Se~^~1~^~6200~\r\n",
    "FOOD_DES.txt": (
        "~09003~^~0900~^~Apples, raw~^~APPLES~^^^~Y~^~Core and stem~^10^^^3.36^8.37^3.60\r\n"
        "~15237~^~1500~^~Salmon~^~SALMON~^^^~Y~^^^^6.25^4.27^9.02^3.87\r\n"
    ),
    "NUT_DATA.txt": (
        "~09003~^~208~^52^0^^~4~^~NC~^^^^^^^^^^^08/2008\r\n"
        "~09003~^~205~^13.81^0^^~4~^~NC~^^^^^^^^^^^08/2008\r\n"
        "~09003~^~207~^0.19^0^^~4~^~NC~^^^^^^^^^^^08/2008\r\n"
        "~15237~^~208~^206^0^^~4~^~NC~^^^^^^^^^^^08/2008\r\n"
    ),
    "WEIGHT.txt": (
        "~09003~^1^1^~cup slices~^109^^\r\r\n"
        '~09003~^2^1^~large (3-1/4" dia)~^223^^\r\r\n'
        "~09003~^3^.5^~cup, chopped~^62^^\r\r\n"
        "~09003~^4^1^~serving 1/2 cup~^60^^\r\r\n"
        "~09003~^5^1^~serving 1 cup~^120^^\r\r\n"
        "~15237~^1^1^~cubic inch, boneless~^17^^\r\r\n"
    ),
}


@pytest.fixture(params=["zip", "folder"])
def release(request, tmp_path):
    if request.param == "zip":
        path = tmp_path / "sr28asc.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in SR28_FILES.items():
                archive.writestr(name, text.encode("cp1252"))
        return Sr28Release(path)
    for name, text in SR28_FILES.items():
        (tmp_path / name).write_bytes(text.encode("cp1252"))
    return Sr28Release(tmp_path)


def test_sr28_foods_nutrients_and_groups_are_read_from_zip_and_folder(release):
    foods = release.foods()
    assert foods["09003"].name == "Apples, raw"
    assert (foods["09003"].refuse_percent, foods["09003"].refuse_words) == (10.0, "Core and stem")
    assert foods["15237"].refuse_percent == 0.0
    assert release.groups() == {"0900": "Fruits"}
    assert release.nutrient_definitions() == {"317": ("SE", "Selenium, Se", "ug")}
    assert release.contents(["09003"]) == {"09003": {"ENERC_KCAL": 52.0, "CHOCDF": 13.81}}


def test_sr28_portions_that_are_volumes_turn_into_densities(release):
    portions = {(ndb, p.sequence): p for ndb, found in release.volume_portions().items() for p in found}
    assert set(portions) == {("09003", "1"), ("09003", "3"), ("09003", "4"), ("09003", "5"), ("15237", "1")}
    cup_ml = 236.5882365
    assert portions["09003", "1"].density_g_per_ml == pytest.approx(109.0 / cup_ml)
    assert portions["09003", "3"].density_g_per_ml == pytest.approx(124.0 / cup_ml)
    assert portions["09003", "4"].density_g_per_ml == pytest.approx(120.0 / cup_ml)
    assert portions["09003", "5"].density_g_per_ml == pytest.approx(120.0 / cup_ml)
    assert portions["15237", "1"].unit == Unit.CUBIC_INCH
    assert portions["15237", "1"].density_g_per_ml == pytest.approx(1.037, abs=0.001)


def test_sr28_line_with_too_few_fields_is_named(tmp_path):
    (tmp_path / "FD_GROUP.txt").write_bytes(b"~0100~^~Dairy~\r\n~0200~\r\n")
    with pytest.raises(ValueError, match=r"FD_GROUP.txt, line 2: 1 fields where SR28 has 2"):
        Sr28Release(tmp_path).groups()


def test_sr28_missing_path_truncated_zip_and_missing_file_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        Sr28Release(tmp_path / "nowhere.zip")
    truncated = tmp_path / "truncated.zip"
    truncated.write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(ValueError, match="only a part"):
        Sr28Release(truncated)
    empty = tmp_path / "empty.zip"
    zipfile.ZipFile(empty, "w").close()
    with pytest.raises(FileNotFoundError, match=r"holds no FOOD_DES.txt"):
        Sr28Release(empty).foods()


@pytest.mark.parametrize(
    ("words", "percent", "parts"),
    [
        ("", 0.0, []),
        ("Skin", 36.0, [("skin", 36.0)]),
        ("", 5.0, [("refuse", 5.0)]),
        ("8% core, 16% crown, 26% parings", 49.0, [("core", 7.84), ("crown", 15.68), ("parings", 25.48)]),
        ("Bone 14%, Connective tissue 11%", 25.0, [("bone", 14.0), ("connective tissue", 11.0)]),
        ("Bone, 16%, Connective tissue, 9%", 25.0, [("bone", 16.0), ("connective tissue", 9.0)]),
        ("Seeds, skin, and bud end", 25.0, [("seeds, skin, and bud end", 25.0)]),
        ("35% husk, silk, trimmings; 29% cob", 64.0, [("35% husk, silk, trimmings; 29% cob", 64.0)]),
    ],
)
def test_refuse_is_split_into_its_parts_where_each_has_a_share(words, percent, parts):
    assert parse_refuse(words, percent) == parts


def write_workbook(path, sheet, rows):
    workbook = openpyxl.Workbook()
    workbook.active.title = sheet
    for row in rows:
        workbook.active.append(row)
    workbook.save(path)
    workbook.close()


def test_fao_rows_keep_their_number_and_turn_ranges_and_gravities_into_densities(tmp_path):
    path = tmp_path / "fao.xlsx"
    write_workbook(
        path,
        "Density DB",
        [
            ("Food name and description", "Density in g/ml", "Specific gravity", "BiblioID"),
            ("Beverages", None, None, None),
            ("Rice, boiled", 0.73, None, "KEN"),
            ("Bran", "0.2-0.3", None, "ASI"),
            ("Beer, lager", None, 1.005, "UK 6th"),
        ],
    )
    rows = read_fao_rows(path)
    assert set(rows) == {3, 4, 5}
    assert (rows[3].name, rows[3].g_per_ml, rows[3].biblio_id) == ("Rice, boiled", 0.73, "KEN")
    assert (rows[4].g_per_ml, rows[4].half_range_g_per_ml) == (pytest.approx(0.25), pytest.approx(0.05))
    assert rows[5].g_per_ml == pytest.approx(1.005 * WATER_G_PER_ML)


def test_workbook_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "other.xlsx"
    write_workbook(path, "Sheet", [("a",)])
    with pytest.raises(ValueError, match="no sheet 'Density DB'"):
        read_fao_rows(path)


def specimens(*densities, volume_ml=200.0):
    return [Specimen(str(number), volume_ml, volume_ml * density) for number, density in enumerate(densities)]


def test_impossible_fruit_is_left_out_and_counted():
    found = measured_density("orange", specimens(0.85, 0.90, 0.95, 1.38, 0.5))
    assert (found.specimens, found.excluded, found.g_per_ml) == (3, 2, 0.9)
    assert found.sd_g_per_ml == pytest.approx(0.05)


def test_food_that_is_no_fruit_keeps_all_its_specimens():
    assert measured_density("bread", specimens(0.17, 0.19, 0.21)).g_per_ml == 0.19


def test_spread_is_never_less_than_rounding_allows():
    found = measured_density("egg", specimens(1.0, 1.0, 1.0, volume_ml=50.0))
    assert found.sd_g_per_ml == pytest.approx(10.0 / 12.0**0.5 / 50.0, abs=5e-4)


def test_too_few_possible_specimens_are_refused():
    with pytest.raises(ValueError, match="takes two"):
        measured_density("orange", specimens(0.9, 1.4))


def test_measured_densities_survive_writing_and_reading():
    measured = [measured_density("orange", specimens(0.85, 0.9, 0.95)), measured_density("egg", specimens(1.0, 1.1))]
    assert read_measured(write_measured(measured)) == {density.food: density for density in measured}
