"""The search on both databases, over small tables of known foods."""

import contextlib
import json
from dataclasses import replace
from datetime import date

import pytest
import sqlalchemy as sa
from hypothesis import given, settings
from hypothesis import strategies as st

from app.db.migrate import upgrade
from app.db.session import Database, normalise_url
from app.foods.import_foods import import_foods
from app.foods.importers.source_files import ImportedTable, Skipped
from app.foods.search import search_foods as search
from app.foods.search.search_foods import food_groups, search_foods
from app.nutrition.foods import Food, FoodTable
from tests.conftest import postgres_database
from tests.support.food_queries import judged

FRUIT, DISHES = "Fruits and Fruit Juices", "Meals, Entrees, and Side Dishes"


def food(name, key=None, group=FRUIT, **changes):
    plain = Food(
        key=key or name.lower().replace(" ", "-"),
        name=name,
        aliases=(),
        food_group=group,
        form="whole",
        slice_form=None,
        refuse=(),
        densities=(),
        per_100_g={},
        source_ids={},
    )
    return replace(plain, **changes)


def put(database, *foods, source="sr28", name=None, version="1"):
    table = FoodTable(name or source, version, date(2026, 1, 1), f"{name or source} {version}", foods)
    import_foods(database, ImportedTable(source, table, (), Skipped()), "test")


def names(database, words, **arguments):
    return [found.name for found in search_foods(database, words, **arguments)]


ORCHARD = (
    food("Strudel, apple", group="Baked Products"),
    food("Apples, dried, uncooked"),
    food("Apples, raw, with skin", source_ids={"sr28_ndb": "09003"}, state="raw"),
    food("Bananas, raw"),
    food("Spaghetti, cooked", group="Cereal Grains and Pasta"),
    food("Soup, chicken noodle, canned", group="Soups"),
    food("Ice cream, vanilla", group="Dairy"),
    food("Popcorn", group="Snacks"),
    food("Squash, zucchini, raw", aliases=("courgette", "苹果瓜", "кабачок"), group="Vegetables"),
    food("Crème fraîche", group="Dairy"),
    food("Broccoli, raw", group="Vegetables"),
    food("Blackberries, raw"),
)


@pytest.fixture(scope="module", params=["sqlite", "postgres"])
def grown(request, tmp_path_factory):
    """The orchard, for tests that only read."""
    with contextlib.ExitStack() as stack:
        if request.param == "sqlite":
            url = f"sqlite:///{tmp_path_factory.mktemp('orchard') / 'tada.sqlite3'}"
        else:
            url = stack.enter_context(postgres_database(request.getfixturevalue("postgres_server")))
        database = Database(url)
        stack.callback(database.dispose)
        upgrade(database)
        put(database, *ORCHARD)
        yield database


@pytest.fixture
def orchard(database):
    """One of its own, for tests that add to it."""
    put(database, *ORCHARD)
    return database


def test_what_is_meant_is_found_first(grown):
    expected = {
        "Apples, raw, with skin": ("apple", "APPLES", "app", "a", "skin apple", "09003", "aple", "a " * 50),
        "Bananas, raw": ("bannana",),
        "Spaghetti, cooked": ("spagetti",),
        "Soup, chicken noodle, canned": ("chiken noodel soup",),
        "Ice cream, vanilla": ("icecream",),
        "Popcorn": ("pop corn",),
        "Squash, zucchini, raw": ("courgettes", "瓜", "КАБАЧОК", "кабачек", "squash,-zucchini,-raw"),
        "Crème fraîche": ("creme",),
        "Broccoli, raw": ("brocc", "brocolli"),
        "Blackberries, raw": ("blackberr",),
    }
    expected["Apples, raw, with skin"] += ("apple\x00", "%apple_", "🍎 apple")  # signs do not matter
    for first, queries in expected.items():
        for words in queries:
            assert names(grown, words)[0] == first, words


def test_what_no_food_has_finds_nothing(grown):
    for words in (
        "%",
        "_",
        "\x00",
        "\U0001f34e",
        ",;!",
        "xyzzy",
        "apple xyzzyx qqq",
        "'; --",
        "\udcff",
        "\u202e",
        "a" * 100,
    ):
        assert names(grown, words) == [], words


@settings(max_examples=60, deadline=None, derandomize=True)
@given(words=st.text(max_size=100) | st.text(alphabet="aeplr %_*'-,苹果", max_size=40))
def test_whatever_is_typed_is_answered(grown, words):
    found = search_foods(grown, words, limit=5)
    assert len(found) <= 5
    assert len({food.key for food in found}) == len(found)


def test_without_words_foods_come_in_the_tables_order_and_the_limit_is_kept(grown):
    for words in (None, "", "  "):
        assert names(grown, words, limit=3) == [one.name for one in ORCHARD[:3]]
    assert len(names(grown, "apple", limit=1)) == 1


def test_groups_are_counted_and_narrow_down_case_aside_and_an_unknown_one_is_empty(grown):
    counted = [(group.name, group.foods) for group in food_groups(grown)]
    assert counted[:2] == [("Baked Products", 1), ("Cereal Grains and Pasta", 1)]
    assert names(grown, "apple", group="baked products") == ["Strudel, apple"]
    assert names(grown, None, group=" FRUITS and fruit juices") == [f.name for f in ORCHARD if f.food_group == FRUIT]
    assert names(grown, "apple", group="Baked") == names(grown, None, group="\x00") == []


def test_summary_says_what_matched_and_where_the_food_is_from(grown):
    (found, *_) = search_foods(grown, "courgette")
    assert (found.matched, found.release, found.is_mixed_dish, found.state) == ("courgette", "sr28 1", False, None)
    assert search_foods(grown, "09003")[0].matched == "09003"
    assert search_foods(grown, None)[0].matched is None


def test_empty_database_finds_nothing(database):
    assert search_foods(database, "apple") == search_foods(database) == food_groups(database) == []


def test_same_food_of_two_releases_is_listed_once_from_the_one_that_goes_first(orchard):
    put(orchard, food("Apple", key="apple", source_ids={"sr28_ndb": "09003"}), source="starter")
    raw = [(found.key, found.name) for found in search_foods(orchard, "apple raw")]
    assert raw == [("apples,-raw,-with-skin", "Apples, raw, with skin")]
    assert names(orchard, "apple")[:2] == ["Apple", "Apples, dried, uncooked"]
    named = {"sr28_ndb": "09003", "sr28_name": "Apples, raw, with skin"}
    put(orchard, food("Apple", key="apple", source_ids=named), source="starter", version="2")
    assert [found.key for found in search_foods(orchard, "apples raw with skin")] == ["apple"]
    put(orchard, food("Popcorn, salted", key="popcorn", group="Snacks"), source="csv")  # of the same key
    assert names(orchard, "popcorn") == ["Popcorn, salted"]


def test_foods_of_two_tables_that_share_a_class_or_a_data_set_stay_two(orchard):
    """A FoodEx2 code is a class of foods, and the data set says nothing of the food: neither makes two foods one."""
    ids = {"foodex2": "A01DJ", "fdc_data_type": "sr_legacy_food"}
    put(orchard, food("Quince, pear-shaped", source_ids=ids), source="fdc", name="fdc-sr-legacy")
    put(orchard, food("Quince, apple-shaped", source_ids=ids), source="csv", name="bls")
    assert sorted(names(orchard, "quince")) == ["Quince, apple-shaped", "Quince, pear-shaped"]


def test_a_release_that_is_replaced_is_searched_no_more(orchard):
    put(orchard, food("Quince, raw"), version="2")
    assert names(orchard, "apple") == []
    assert names(orchard, "quinces") == ["Quince, raw"]


def test_a_dish_defaults_to_fndds_once_that_is_imported(database):
    ours = food("Lasagna with meat sauce", aliases=("lasagna",), group=DISHES, is_mixed_dish=True)
    put(database, ours, source="starter")
    assert names(database, "lasagna") == [ours.name]
    number = {"fndds": "58130011"}
    fndds = food("Lasagna, meat, frozen", group="Pasta mixed dishes", is_mixed_dish=True, source_ids=number)
    put(database, fndds, source="fdc")
    assert names(database, "lasagna") == [fndds.name, ours.name]


def test_command_finds_and_says_no(tada):
    answer = tada("search", "red", "aple", "--limit", "1", "--json")
    assert (answer.returncode, [food["key"] for food in json.loads(answer.stdout)]) == (0, ["apple"])
    assert tada("search", "apple", "--group", "Fruits and Fruit Juices").stdout.startswith("apple ")
    nothing = tada("search", "xyzzy")
    assert (nothing.returncode, nothing.stdout) == (1, "No food of that name.\n")


def test_scan_limit_does_not_change_search_results(sqlite_template, monkeypatch):
    database = Database(f"sqlite:///{sqlite_template}")
    queries = ["raw skin", "with skin raw", "cheese w", "boiled beans", "chicken c", "sauce with", "rice cooked b"]
    monkeypatch.setattr(search, "RANKED", 5)
    answers = []
    for scanned in (5, 20, 10_000):
        monkeypatch.setattr(search, "SCANNED", scanned)
        answers.append([[found.key for found in search_foods(database, query, limit=5)] for query in queries])
    database.dispose()
    assert answers[0] == answers[1] == answers[2]
    assert all(answers[0])


@pytest.mark.slow
def test_both_databases_give_the_same_order(sqlite_template, postgres_template, postgres_server):
    on_postgres = sa.make_url(normalise_url(postgres_server)).set(database=postgres_template)
    queries = [row["query"] for row in judged()]
    queries += [*"abcprst", "ch", "co", "with", "raw", "cooked", "chese", "bred", "e g"]
    answers = []
    for url in (f"sqlite:///{sqlite_template}", on_postgres.render_as_string(hide_password=False)):
        database = Database(url)
        answers.append({query: [found.key for found in search_foods(database, query, limit=100)] for query in queries})
        database.dispose()
    assert answers[0] == answers[1]
    assert sum(bool(keys) for keys in answers[0].values()) > 80
