"""SR28: small releases of our own, each way to be wrong, and the release itself beside an independent reading."""

import zipfile

import pytest

from app.foods.importers.source_files import ImportFileError
from app.foods.importers.sr28 import parse_refuse, read_sr28
from app.nutrition.mass import edible_share
from tests.unit.foods.importers.release_files import replaced, write_folder

CUP_ML = 236.5882365

FILES = {
    "FD_GROUP.txt": "~0900~^~Fruits and Fruit Juices~\r\n~1500~^~Finfish and Shellfish Products~\r\n",
    "NUTR_DEF.txt": (
        "~203~^~g~^~PROCNT~^~Protein~^~2~^~600~\r\n"
        "~205~^~g~^~CHOCDF~^~Carbohydrate, by difference~^~2~^~1100~\r\n"
        "~208~^~kcal~^~ENERC_KCAL~^~Energy~^~0~^~300~\r\n"
        "~317~^~\u00b5g~^~SE~^~Selenium, Se~^~1~^~6200~\r\n"
        "~999~^~mg~^~~^~Newly measured~^~1~^~9999~\r\n"
    ),
    "FOOD_DES.txt": (
        "~09003~^~0900~^~Apples, raw~^~APPLES~^~red apple, apples, URMIS #1~^~~^~Y~^~Core and stem~^10^~~^^3^8^3\r\n"
        "~15237~^~1500~^~Salmon, cooked~^~SALMON~^~~^~~^~Y~^~~^^~~^^4.27^9.02^3.87"
    ),
    "NUT_DATA.txt": "".join(
        f"~{ndb}~^~{number}~^{value}^0^^~4~^~NC~^~~^~~^^^^^^^~~^~~^~08/2008~\r\n"
        for ndb, number, value in (
            ("09003", "208", "52"), ("09003", "205", "13.81"), ("09003", "999", "0"), ("15237", "208", "206"),
        )
    ),
    "WEIGHT.txt": (
        "~09003~^1^1^~cup slices~^109^^\r\r\n"
        '~09003~^2^1^~large (3-1/4" dia)~^223^^\r\r\n'
        "~09003~^3^.5^~cup, chopped~^62^^\r\r\n"
        "~09003~^4^1^~serving 1/2 cup~^60^^\r\r\n"
        "~09003~^5^1^~cup, with ice~^60^^\r\r\n"
        "~15237~^1^1^~cubic inch, boneless~^17^^\r\r\n"
    ),
}  # fmt: skip


def read(tmp_path, **changed):
    """The small release with some of its files changed: name without .txt -> function of the text."""
    files = {name: changed.get(name[:-4], lambda text: text)(text) for name, text in FILES.items()}
    files = {name: text for name, text in files.items() if text is not None}
    return read_sr28(write_folder(tmp_path / "sr28", files, encoding="cp1252"))


def test_food_carries_names_refuse_contents_portions_and_ids(tmp_path):
    imported = read(tmp_path)
    apple, salmon = imported.table.foods
    assert (imported.table.name, imported.table.version, len(imported.table.checksum)) == ("sr28", "28", 64)
    assert (apple.key, apple.name, apple.food_group) == ("sr28:09003", "Apples, raw", "Fruits and Fruit Juices")
    assert apple.source_ids == {"sr28_ndb": "09003"}
    assert apple.aliases == ("red apple",)
    assert [(part.part, part.percent) for part in apple.refuse] == [("core and stem", 10.0)]
    assert apple.per_100_g == {"208": 52.0, "205": 13.81, "999": 0.0}
    assert [portion.measure for portion in apple.portions][:2] == ["cup slices", 'large (3-1/4" dia)']
    assert (apple.state, apple.form, salmon.state, salmon.form) == ("raw", "whole", "cooked", "slab")
    assert [component.number for component in imported.components] == ["208", "203", "205", "317", "999"]


def test_volume_portions_become_densities_of_their_kind(tmp_path):
    apple, salmon = read(tmp_path).table.foods
    assert {(d.kind, d.state): d.g_per_ml for d in apple.densities} == {
        ("bulk", "slices"): pytest.approx(109.0 / CUP_ML, abs=5e-4),
        ("bulk", "chopped"): pytest.approx(124.0 / CUP_ML, abs=5e-4),
        ("bulk", "raw"): pytest.approx(120.0 / CUP_ML, abs=5e-4),
    }
    (cube,) = salmon.densities
    assert (cube.kind, cube.g_per_ml) == ("solid", pytest.approx(17.0 / 16.387064, abs=5e-4))


def test_figures_in_another_unit_are_converted_and_a_portion_of_no_weight_is_left_out_and_counted(tmp_path):
    apple = read(tmp_path, NUTR_DEF=lambda text: text.replace("~205~^~g~", "~205~^~mg~")).table.foods[0]
    assert apple.per_100_g["205"] == pytest.approx(0.01381)
    imported = read(tmp_path, WEIGHT=lambda text: text.replace("^223^", "^0^"))
    assert len(imported.table.foods[0].portions) == 4
    assert [*imported.skipped.sentences()] == ['1 portions of no amount or weight (09003 large (3-1/4" dia))']


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("FOOD_DES", lambda text: text + "\r\n" + text, r"FOOD_DES.txt, line 3: food 09003 is there twice"),
        ("FOOD_DES", replaced("~0900~", "~0800~"), r"FOOD_DES.txt, line 1: food 09003 is of group 0800, which FD"),
        ("FOOD_DES", replaced("^10^", "^-10^"), r"FOOD_DES.txt, line 1: the refuse is -10, which cannot be"),
        ("FOOD_DES", replaced("^10^", "^100^"), r"FOOD_DES.txt, line 1: a refuse of 100 % leaves nothing"),
        ("FOOD_DES", lambda text: text[:150], r"FOOD_DES.txt, line 2: \d+ fields where SR28 has 14; is the file cut"),
        ("FD_GROUP", lambda text: text[:-8], r"FD_GROUP.txt, line 2: the text ~Finfish.* has no end; is"),
        ("NUTR_DEF", replaced("~205~^~g~", "~205~^~kcal~"), r"NUTR_DEF.txt, line 2: component 205 .* does not fit g"),
        ("NUT_DATA", replaced("^13.81^", "^-13.81^"), r"NUT_DATA.txt, line 2: nutrient 205 is -13.81, which cannot be"),
        ("NUT_DATA", replaced("~205~", "~208~"), r"NUT_DATA.txt, line 2: nutrient 208 of food 09003 is there twice"),
        ("NUT_DATA", replaced("~205~", "~777~"), r"NUT_DATA.txt, line 2: nutrient 777 is none of NUTR_DEF.txt"),
        ("NUT_DATA", lambda text: text.rpartition("~15237~")[0], r"NUT_DATA.txt: it has no value of food 15237"),
        ("WEIGHT", replaced("~09003~^2^", "~09003~^1^"), r"WEIGHT.txt, line 2: portion 09003 1 is there twice"),
        ("WEIGHT", replaced("~15237~", "~15238~"), r"WEIGHT.txt, line 6: food 15238 is none of FOOD_DES.txt"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_file_and_line(tmp_path, file, change, message):
    with pytest.raises(ImportFileError, match=message):
        read(tmp_path, **{file: change})


@pytest.mark.parametrize(
    ("words", "percent", "parts"),
    [
        ("", 0.0, []),
        ("", 5.0, [("refuse", 5.0)]),
        ("0% skin", 5.0, [("0% skin", 5.0)]),
        ("8% core, 16% crown, 26% parings", 49.0, [("core", 7.84), ("crown", 15.68), ("parings", 25.48)]),
        ("Bone 14%, Connective tissue 11%", 25.0, [("bone", 14.0), ("connective tissue", 11.0)]),
        ("Bone, 16%, Connective tissue, 9%", 25.0, [("bone", 16.0), ("connective tissue", 9.0)]),
        ("35% husk, silk, trimmings; 29% cob", 64.0, [("35% husk, silk, trimmings; 29% cob", 64.0)]),
    ],
)
def test_refuse_is_split_into_its_parts_where_each_has_a_share(words, percent, parts):
    assert parse_refuse(words, percent) == parts


# The release itself, where it is at hand, beside a reading that shares nothing with the importer.


@pytest.fixture(scope="module")
def plainly(shared_data):
    with zipfile.ZipFile(shared_data / "food_tables" / "sr28asc.zip") as archive:

        def fields(name):
            for line in archive.read(name).decode("latin-1").replace("\r", "").split("\n"):
                if line:
                    yield line.replace("~", "").split("^")

        return {name: [*fields(f"{name}.txt")] for name in ("FOOD_DES", "NUT_DATA", "WEIGHT")}


@pytest.mark.slow
def test_every_food_value_and_portion_of_the_release_is_there_and_none_is_skipped(sr28_table, plainly):
    foods = {food.source_ids["sr28_ndb"]: food for food in sr28_table.table.foods}
    names = {row[0]: " ".join(row[2].split()) for row in plainly["FOOD_DES"]}
    assert {ndb: food.name for ndb, food in foods.items()} == names
    contents = {(row[0], row[1]): float(row[2]) for row in plainly["NUT_DATA"]}
    assert {(ndb, number): v for ndb, food in foods.items() for number, v in food.per_100_g.items()} == contents
    assert sum(len(food.portions) for food in foods.values()) == len(plainly["WEIGHT"])
    assert [*sr28_table.skipped.sentences()] == []
    assert (len(foods), len(contents)) == (8789, 679_045)


def test_refuse_of_a_heap_is_off_before_the_plate_and_that_of_a_piece_is_not(tmp_path):
    def berries(text):
        return text.replace("Apples, raw", "Berries, raw").replace("Core and stem", "Stems")

    piece, _ = read(tmp_path / "piece").table.foods
    heap, _ = read(tmp_path / "heap", FOOD_DES=berries).table.foods
    assert (piece.form, edible_share(piece)) == ("whole", pytest.approx(0.9))
    assert (heap.form, edible_share(heap)) == ("heap", 1.0)
