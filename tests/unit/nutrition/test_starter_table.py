"""The starter table as it ships, and its rebuilding from the public releases."""

import tomllib

import pytest

from app.nutrition.build_starter import STARTER_DIR, StarterSources, build, main
from app.nutrition.components import HEADLINE_COMPONENTS
from app.nutrition.density import KIND_OF_FORM
from app.nutrition.foods import load_starter_table, parse_table
from app.nutrition.importers.ecustfd import read_measured
from app.nutrition.importers.fao_density import read_fao_rows
from app.nutrition.importers.sr28 import Sr28Release

COMPACT_BYTES = 150_000


@pytest.fixture(scope="module")
def sources(shared_data):
    tables = shared_data / "food_tables"
    return StarterSources(
        Sr28Release(tables / "sr28asc.zip"),
        read_fao_rows(tables / "fao_infoods_density_v2.xlsx"),
        read_measured((STARTER_DIR / "ecustfd.csv").read_text()),
    )


def selection():
    return tomllib.loads((STARTER_DIR / "selection.toml").read_text())


def test_rebuilding_from_the_releases_gives_what_is_committed(sources):
    foods_json, nutrients_csv = build(sources, selection())
    assert foods_json == (STARTER_DIR / "foods.json").read_bytes()
    assert nutrients_csv == (STARTER_DIR / "nutrients.csv").read_bytes()


def test_command_writes_a_table_that_loads(shared_data, tmp_path, capsys):
    tables = shared_data / "food_tables"
    main(
        [
            *("--sr28", str(tables / "sr28asc.zip")),
            *("--fao", str(tables / "fao_infoods_density_v2.xlsx")),
            *("-o", str(tmp_path)),
        ]
    )
    table = parse_table((tmp_path / "foods.json").read_bytes(), (tmp_path / "nutrients.csv").read_bytes())
    assert table.foods == load_starter_table().foods
    assert f"{len(table.foods)} foods" in capsys.readouterr().out


def test_selection_that_names_another_fao_row_is_refused(sources):
    changed = selection()
    changed["food"] = [food for food in changed["food"] if food["key"] == "rice-white-cooked"]
    changed["food"][0]["fao"][0]["row"] = 370
    with pytest.raises(ValueError, match="FAO row 370 is 'Rice, rough'"):
        build(sources, changed)


def test_food_without_a_density_for_its_form_is_refused(sources):
    changed = selection()
    changed["food"] = [food for food in changed["food"] if food["key"] == "lasagna"]
    del changed["food"][0]["fao"]
    with pytest.raises(ValueError, match="lasagna: no solid density"):
        build(sources, changed)


def test_selection_that_names_refuse_unknown_to_the_release_is_refused(sources):
    changed = selection()
    changed["food"] = [food for food in changed["food"] if food["key"] == "banana"]
    changed["food"][0]["served_without"] = ["crown"]
    with pytest.raises(ValueError, match="banana: SR28 names no part"):
        build(sources, changed)


@pytest.mark.parametrize(
    ("key", "ndb_number", "tagname", "content"),
    [
        ("apple", "09003", "ENERC_KCAL", 52.0),
        ("apple", "09003", "CHOCDF", 13.81),
        ("banana", "09040", "ENERC_KCAL", 89.0),
        ("banana", "09040", "K", 358.0),
        ("orange", "09200", "ENERC_KCAL", 47.0),
        ("orange", "09200", "VITC", 53.2),
        ("pear", "09252", "ENERC_KCAL", 57.0),
        ("pineapple", "09266", "ENERC_KCAL", 50.0),
        ("kiwifruit", "09148", "ENERC_KCAL", 61.0),
        ("kiwifruit", "09148", "VITC", 92.7),
        ("rice-white-cooked", "20045", "ENERC_KCAL", 130.0),
        ("egg-boiled", "01129", "PROCNT", 12.58),
    ],
)
def test_figures_are_those_of_sr28(key, ndb_number, tagname, content):
    food = load_starter_table().food(key)
    assert food.source_ids["sr28_ndb"] == ndb_number
    assert food.per_100_g[tagname] == content


def test_unpublished_content_is_absent():
    assert "VITC" not in load_starter_table().food("apple-green").per_100_g


def test_each_food_has_a_density_of_its_forms_kind_with_source_and_state():
    for food in load_starter_table().foods:
        assert any(density.kind == KIND_OF_FORM[food.form] for density in food.densities), food.key
        assert all(density.source and density.state and density.sd_g_per_ml > 0.0 for density in food.densities)


def test_values_fit_the_columns_that_they_will_be_stored_in():
    for food in load_starter_table().foods:
        assert len(food.key) <= 100
        assert len(food.name) <= 200
        for density in food.densities:
            assert len(density.state) <= 32
            assert len(density.source) <= 300


def test_each_food_knows_its_energy_and_macronutrients():
    for food in load_starter_table().foods:
        assert {"ENERC_KCAL", "PROCNT", "FAT", "CHOCDF"} <= set(food.per_100_g), food.key
        assert len(set(HEADLINE_COMPONENTS) & set(food.per_100_g)) >= 8, food.key


def test_energy_agrees_with_its_macronutrients():
    for food in load_starter_table().foods:
        content = food.per_100_g
        atwater = 4.0 * (content["PROCNT"] + content["CHOCDF"]) + 9.0 * content["FAT"] + 7.0 * content.get("ALC", 0.0)
        # General Atwater factors overrate fibre and fruit acids (lemon by half); this finds swapped rows.
        assert content["ENERC_KCAL"] == pytest.approx(atwater, rel=0.25, abs=16.0), food.key


def test_the_papers_fruit_have_its_slice_forms():
    table = load_starter_table()
    assert {key: table.food(key).slice_form for key in ("apple", "orange", "pear")} == dict.fromkeys(
        ("apple", "orange", "pear"), "circle"
    )
    assert {table.food(key).slice_form for key in ("pineapple", "banana", "kiwifruit")} == {"ellipse"}


def test_pineapples_refuse_is_stored_by_part_and_adds_up_to_the_published_total():
    parts = {part.part: part.percent for part in load_starter_table().food("pineapple").refuse}
    assert set(parts) == {"core", "crown", "parings"}
    assert sum(parts.values()) == pytest.approx(49.0, abs=0.02)


def test_release_names_itself_and_what_ships_is_compact():
    table = load_starter_table()
    assert (table.name, table.version) == ("tada-starter", "1")
    assert len(table.checksum) == 64
    assert sum(file.stat().st_size for file in STARTER_DIR.iterdir()) < COMPACT_BYTES


def test_changed_file_changes_the_checksum():
    foods_json = (STARTER_DIR / "foods.json").read_bytes()
    nutrients_csv = (STARTER_DIR / "nutrients.csv").read_bytes()
    assert parse_table(foods_json + b"\n", nutrients_csv).checksum != load_starter_table().checksum


def test_unknown_food_is_a_key_error():
    with pytest.raises(KeyError):
        load_starter_table().food("unicorn")
