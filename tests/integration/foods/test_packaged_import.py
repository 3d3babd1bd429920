"""Open Food Facts' dump: labels per 100 g and per serving, kJ and kcal, what cannot be, and what is missing."""

import json
from types import SimpleNamespace

import pytest
import sqlalchemy as sa

from app.core.errors import ConflictError
from app.db.session import Database
from app.foods.food_releases import list_releases, use_release
from app.foods.foods import read_food
from app.foods.importers.source_files import ImportFileError
from app.foods.packaged import import_packaged as module
from app.foods.packaged.import_packaged import import_packaged
from app.foods.packaged.models import PackagedFood
from app.foods.packaged.packaged_foods import adopt
from tests.integration.foods.dumps import COCOA, NO_LABEL, write_dump

NUMBERS = {
    "energy_kcal": "208", "protein_g": "203", "fat_g": "204", "carbohydrate_g": "205", "sugar_g": "269",
    "available_carbohydrate_g": "CHOAVL", "fibre_g": "291", "sodium_mg": "307",
}  # fmt: skip
WATER = {**NO_LABEL, "code": "96385074", "product_name": "Water", "quantity": "6 x 1,5 L", "energy-kcal_100g": "0"}


@pytest.fixture
def database(prepared_database_url):
    database = Database(prepared_database_url)
    yield database
    database.dispose()


def shown(row):
    """Return the columns of a row, with the label's figures by their components' names."""
    per_100_g = json.loads(row.per_100_g)
    return SimpleNamespace(
        **{name: getattr(row, name) for name in ("name", "pack_g", "serving_g", "is_liquid")},
        **{name: per_100_g[number] for name, number in NUMBERS.items()},
    )


@pytest.fixture
def imported(database, tmp_path):
    """Import rows and return the rows that were kept, by code, and how many were refused for which reason."""

    def run(*rows, name="dump.csv", **changes):
        table, _ = import_packaged(database, write_dump(tmp_path / name, *rows, **changes), "me", print)
        with database.read() as session:
            kept = {row.code: shown(row) for row in session.scalars(sa.select(PackagedFood))}
        return kept, dict(table.skipped.counts)

    return run


@pytest.mark.both_stores
def test_label_is_kept_as_it_is_and_what_it_lacks_is_not_zero(imported):
    kept, refused = imported({}, WATER, name="dump.csv.gz")
    assert refused == {}
    cocoa, water = kept[3017620422003], kept[96385074]
    assert (cocoa.name, cocoa.pack_g, cocoa.serving_g, cocoa.is_liquid) == (
        "Cocoa spread, Ferrero", 400, 15, False,
    )  # fmt: skip
    assert (cocoa.energy_kcal, cocoa.fat_g, cocoa.sugar_g, cocoa.sodium_mg) == (539, 30.9, 56.3, 42.8)
    # European carbohydrate is without fibre, and fibre is not on the label
    assert (cocoa.available_carbohydrate_g, cocoa.carbohydrate_g, cocoa.fibre_g) == (57.5, None, None)
    assert (water.energy_kcal, water.fat_g, water.protein_g, water.sodium_mg) == (0, None, None, None)
    assert (water.pack_g, water.is_liquid) == (9000, True)


SERVING = {
    "energy-kcal_serving": "81",
    "fat_serving": "4.635",
    "carbohydrates_serving": "8.625",
    "proteins_serving": "0.945",
}
FAULTS = {
    "whose code is no GTIN": [{"code": "3017620422004"}, {"code": "123"}, {"code": "0000000000000"}, {"code": ""}],
    "without a name": [{"product_name": "  "}],
    "without figures": [NO_LABEL],
    "with a figure below zero": [{"salt_100g": "-0.1"}],
    "with more than 100 g of a nutrient in 100 g": [{"fat_100g": "309"}, {"sodium_100g": "42.8"}],
    "with nutrients of more than 100 g together": [{"proteins_100g": "16.3"}],
    "with a part larger than its whole": [{"saturated-fat_100g": "32"}, {"sugars_100g": "59"}],
    "with kJ given as kcal": [
        {"energy-kcal_100g": "2252", "energy-kj_100g": "", "energy_100g": "9422"},
        {"energy-kcal_100g": "2252", "proteins_100g": ""},
    ],
    "with an energy that its nutrients do not have": [
        {"energy-kcal_100g": "129", "energy-kj_100g": "", "energy_100g": "539"},  # kcal given as kJ
        {"energy-kcal_100g": "200"},
        {**NO_LABEL, "energy-kcal_100g": "4500"},
    ],
    "with different energies in kJ and kcal": [{"energy-kj_100g": "1500"}],
    "with figures of a serving of unknown weight": [
        {"nutrition_data_per": "serving", "serving_quantity": ""} | SERVING
    ],
    "with figures of a serving under 100 g": [{"energy-kcal_serving": "539", "fat_serving": "30.9"}],
}


@pytest.mark.parametrize("reason", FAULTS)
def test_row_that_cannot_be_is_refused_with_its_reason(imported, reason):
    kept, refused = imported(WATER, *FAULTS[reason])
    assert refused == {reason: len(FAULTS[reason])}
    assert list(kept) == [96385074]


def test_label_of_a_serving_is_converted_by_its_weight(imported):
    # what stands under 100 g is not read: it may be the serving's as well
    copied = {name.replace("_serving", "_100g"): value for name, value in SERVING.items()}
    kept, refused = imported(
        {"nutrition_data_per": "serving"} | SERVING | copied | {"energy-kj_100g": "", "energy_100g": ""}
    )
    assert refused == {}
    row = kept[3017620422003]
    assert (row.energy_kcal, row.fat_g, row.available_carbohydrate_g, row.protein_g) == (540, 30.9, 57.5, 6.3)


GUM = NO_LABEL | {
    "fat_100g": "0", "carbohydrates_100g": "90", "polyols_100g": "90", "proteins_100g": "0", "energy-kcal_100g": "18",
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "kcal"),
    [
        ({"energy-kcal_100g": "", "energy-kj_100g": ""}, 538.2),  # energy_100g is kJ
        ({"energy-kcal_100g": "", "energy_100g": ""}, 538.2),
        (GUM, 18),
    ],
)
def test_energy_is_kcal_whatever_the_label_gives(imported, changes, kcal):
    kept, refused = imported(changes)
    assert refused == {}
    assert kept[3017620422003].energy_kcal == kcal


@pytest.mark.parametrize(
    ("countries", "with_fibre", "available"),
    [("en:france", 60.5, 57.5), ("en:canada,en:united-states", 57.5, 54.5), ("en:france,en:canada", None, None)],
)
def test_carbohydrate_includes_fibre_where_the_country_counts_it(imported, countries, with_fibre, available):
    row = imported({"countries_tags": countries, "fiber_100g": "3"})[0][3017620422003]
    assert (row.carbohydrate_g, row.available_carbohydrate_g) == (with_fibre, available)


@pytest.mark.parametrize(
    ("quantity", "pack_g"),
    [("12 oz (340 g)", 340), ("1.000 g", 1000), ("1,5kg", 1500), ("4 × 125g", 500), ("a dozen", None), ("12 oz", None)],
)
def test_size_of_the_pack(imported, quantity, pack_g):
    assert imported({"quantity": quantity})[0][3017620422003].pack_g == pack_g


def test_code_that_is_there_twice_is_as_it_was_modified_last(imported):
    older = {"last_modified_t": "1600000000", "product_name": "Old"}
    kept, refused = imported(older, {"code": "03017620422003", "product_name": "New"}, older)
    assert [row.name for row in kept.values()] == ["New, Ferrero"]
    assert refused == {"older rows of a code": 2}


def test_columns_that_are_missing_and_lines_that_are_broken(imported, database, tmp_path):
    columns = [name for name in COCOA if not name.endswith("_serving") and name != "nutrition_data_per"]
    assert imported({}, columns=columns)[0][3017620422003].energy_kcal == 539
    path = write_dump(tmp_path / "broken.csv", {}, WATER)
    path.write_text(path.read_text().replace("Water\t", 'Water "still\t') + "123\tshort line\n")
    table, report = import_packaged(database, path, "me", print)
    assert (report.foods, dict(table.skipped.counts)) == (2, {"lines with other columns than the header": 1})
    with pytest.raises(ImportFileError, match="fat_100g"):
        imported({}, columns=[name for name in COCOA if name != "fat_100g"])


def test_newer_dump_takes_the_place_of_the_older_one_and_foods_that_were_eaten_come_along(imported, database, tmp_path):
    imported({}, WATER)
    with database.write() as session:
        eaten = adopt(session, "off:3017620422003")
        assert adopt(session, "off:3017620422004") is None
        assert adopt(session, "off:96385074") is None  # another writing of a key
    kept, _ = imported({"last_modified_t": "1700100000", "energy-kcal_100g": "545"}, name="newer.csv")
    assert list(kept) == [3017620422003]
    view = read_food(database, "off:3017620422003")
    assert (view.food.id > eaten.id, view.value.per_100_g["208"], view.release) == (
        True,
        545,
        "open-food-facts 2023-11-16",
    )
    older = next(each.release for each in list_releases(database) if each.release.version == "2023-11-14")
    assert older.completed_at is None
    again, _ = imported({}, WATER)
    assert sorted(again) == [96385074, 3017620422003]
    assert read_food(database, "off:3017620422003").food.id == eaten.id
    use_release(database, "open-food-facts", None, "me")


def test_import_that_was_broken_off_goes_on_where_it_stopped(database, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "BATCH_ROWS", 1)
    path = write_dump(tmp_path / "dump.csv", {}, WATER)

    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_packaged(database, path, "me", stop)
    progress = []
    import_packaged(database, path, "me", lambda *counts: progress.append(counts))
    assert progress == [(2, 2)]
    assert import_packaged(database, path, "me", print)[1].was_there


@pytest.mark.both_stores
def test_import_beside_that_of_another_dump_ends(database, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "BATCH_ROWS", 1)
    first = write_dump(tmp_path / "first.csv", {}, WATER)
    second = write_dump(tmp_path / "second.csv", {"last_modified_t": "1700100000"}, WATER)

    def import_second(done, _):
        if done == 1:
            import_packaged(database, second, "me", print)

    with pytest.raises(ConflictError, match="taken over"):
        import_packaged(database, first, "me", import_second)
    with database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(PackagedFood)) == 2
    assert [each.release.version for each in list_releases(database) if each.is_in_force][-1] == "2023-11-16"
