"""Our own template: what each column means, units, traces, files beside it, and everything that is refused."""

import datetime as dt
import pathlib

import pytest

from app.core.errors import InvalidInputError
from app.foods.importers.csv_table import read_csv_table
from app.foods.importers.source_files import ImportFileError
from tests.unit.foods.importers.release_files import write_folder, write_zip

DOCS = pathlib.Path(__file__).parents[4] / "docs"
RELEASED_ON = dt.date(2024, 3, 1)


def read(path, **changed):
    return read_csv_table(path, **{"name": "cofid", "version": "2024", "released_on": RELEASED_ON, **changed})


@pytest.fixture
def table(tmp_path):
    def write(text):
        path = tmp_path / "table.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def only_food(path):
    (food,) = read(path).table.foods
    return food


def test_template_in_the_documents_imports_and_says_what_its_columns_say():
    imported = read(DOCS / "food-template.csv")
    apple, goulash = imported.table.foods
    assert (apple.key, apple.name, apple.food_group) == ("cofid:A001", "Apple, raw, with skin", "Fruits")
    assert apple.aliases == ("apple", "dessert apple")
    assert (apple.form, apple.state, apple.is_mixed_dish) == ("whole", "raw", False)
    assert [(part.part, part.percent, part.is_served) for part in apple.refuse] == [("core and stem", 10.0, True)]
    (density,) = apple.densities
    assert (density.g_per_ml, density.sd_g_per_ml, density.kind, density.basis) == (0.79, 0.03, "solid", "measured")
    assert apple.source_ids == {"foodex2": "A01DJ"}
    assert apple.per_100_g["208"] == 52.0
    assert (goulash.is_mixed_dish, goulash.form, goulash.densities) == (True, "in_vessel", ())
    assert (imported.table.name, imported.table.version, imported.table.released_on) == ("cofid", "2024", RELEASED_ON)
    assert [component.tagname for component in imported.components] == [
        "ENERC_KCAL", "PROCNT", "FAT", "FIBTG", "NA", "VITC", "CHOAVL",
    ]  # fmt: skip


def test_empty_is_not_known_a_trace_is_zero_units_are_converted_and_neighbouring_components_stay_apart(table):
    imported = read(table("key,name,food_group,CA (mg),NA (mg),K (mg),FE (mg)\n1,Bread,Breads,,0,tr,Trace\n"))
    assert imported.table.foods[0].per_100_g == {"307": 0.0, "306": 0.0, "303": 0.0}
    assert [*imported.skipped.sentences()] == ["2 traces, taken as 0 (1 K (mg), 1 FE (mg))"]
    header = "key,name,food_group,ENERC_KCAL (kJ),CA (g),SE (mg),PROCNT (g),VITD (IU),268 (kJ)"
    food = only_food(table(f"{header}\n1,Bread,Breads,418.4,0.02,0.05,9,40,418.4\n"))
    assert food.per_100_g == {
        "208": pytest.approx(100.0),
        "301": pytest.approx(20.0),
        "317": pytest.approx(50.0),
        "203": 9.0,
        "324": 40.0,
        "268": pytest.approx(418.4),
    }
    header = "key,name,food_group,CHOCDF (g),CHOAVL (g),FOL (ug),FOLDFE (µg),VITD (mcg),FIB- (g)"
    food = only_food(table(f"{header}\n1,Bread,Breads,50,45,30,40,1,5\n"))
    assert food.per_100_g == {"205": 50.0, "CHOAVL": 45.0, "417": 30.0, "435": 40.0, "328": 1.0, "FIB-": 5.0}


@pytest.mark.parametrize(("header", "is_refused"), [("ENERC_KCAL (kcal)", False), ("ENERC_KCAL (kJ)", True)])
def test_kilocalories_under_a_header_of_kilojoules_are_noticed(table, header, is_refused):
    foods = "".join(f"A{number},Bread {number},Baked,{250 + number},9,3,47\n" for number in range(12))
    path = table(f"key,name,food_group,{header},PROCNT (g),FAT (g),CHOAVL (g)\n{foods}")
    if is_refused:
        with pytest.raises(ImportFileError, match=r"line 1: the energies are 0.24 times what .* kcal under a header"):
            read(path)
    else:
        assert len(read(path).table.foods) == 12


def test_form_is_judged_where_it_is_empty_and_refuse_in_brackets_is_off_before_the_photograph(table):
    food = only_food(table("key,name,food_group,form,state\n1,Orange juice,Fruits,,\n"))
    assert (food.form, food.state) == ("liquid", None)
    food = only_food(table('key,name,food_group,refuse\n1,Pineapple,Fruits,"(crown) 16; core 7.8; parings 25"\n'))
    assert [(part.part, part.percent, part.is_served) for part in food.refuse] == [
        ("crown", 16.0, False),
        ("core", 7.8, True),
        ("parings", 25.0, True),
    ]


FOODS = "key,name,food_group,form,state\nA,Apple,Fruits,whole,raw\nB,Rice,Cereals,heap,cooked\n"
DENSITIES = "key,g_per_ml,density_kind,density_source\nA,0.79,solid,own\nA,0.5,bulk,own\n"
PORTIONS = 'key,amount,measure,mass_g\nB,1,"cup",158\nB,1,bowl,300\n'


def test_folder_and_zip_carry_more_densities_and_portions(tmp_path):
    files = {"foods.csv": FOODS, "densities.csv": DENSITIES, "portions.csv": PORTIONS}
    table = read(write_folder(tmp_path / "folder", files)).table
    assert read(write_zip(tmp_path / "table.zip", files)).table == table
    apple, rice = table.foods
    assert [(d.kind, d.g_per_ml, d.sd_g_per_ml) for d in apple.densities] == [
        ("solid", 0.79, pytest.approx(0.0632)),
        ("bulk", 0.5, pytest.approx(0.06)),
    ]
    assert [(portion.measure, portion.mass_g) for portion in rice.portions] == [("cup", 158.0), ("bowl", 300.0)]
    (cup,) = rice.densities
    assert (cup.kind, cup.basis, cup.g_per_ml) == ("bulk", "portion", pytest.approx(158 / 236.588, abs=5e-4))


def test_groups_own_median_stands_in_with_a_wide_spread(table):
    rows = "".join(f"{n},Bread {n},Breads,slab,0.{n},solid,own\n" for n in range(20, 26))
    header = "key,name,food_group,form,g_per_ml,density_kind,density_source\n"
    toast = read(table(f"{header}{rows}99,Toast,Breads,slab,,,\n")).table.food("cofid:99")
    (median,) = toast.densities
    assert (median.basis, median.g_per_ml) == ("group", pytest.approx(0.225))
    assert median.sd_g_per_ml == pytest.approx(0.25 * 0.225, abs=5e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("key,name\n1,a\n", r"table.csv, line 1: no column food_group"),
        ("key;name;food_group\n1;a;b\n", r"table.csv, line 1: the columns are separated by semicolons"),
        ("key,name,food_group,colour\n", r"table.csv, line 1: column 'colour' is neither one of key,"),
        ("key,name,food_group,ENERC (kcal)\n", r"line 1: column 'ENERC \(kcal\)': unknown component .*ENERC_KCAL or"),
        ("key,name,food_group,CA (kcal)\n", r"line 1: column 'CA \(kcal\)': kcal does not fit CA, .* in mg"),
        ("key,name,food_group,CA (mg),301 (g)\n", r"line 1: column '301 \(g\)': Calcium, Ca has a column already"),
        ("key,name,food_group\n", r"table.csv: it holds no food"),
        ("key,name,food_group\n1,a,g\n1,b,g\n", r"table.csv, line 3: food 1 is there twice"),
        ("key,name,food_group\n,a,g\n", r"table.csv, line 2: key is empty"),
        ("key,name,food_group\na/b,a,g\n", r"table.csv, line 2: key 'a/b' has more in it than letters"),
        (f"key,name,food_group\n1,{'a' * 301},g\n", r"table.csv, line 2: name has 301 characters; at most 300"),
        ("key,name,food_group,state\n1,a,g,boiled\n", r"line 2: state is 'boiled'; give one of raw, cooked, as_eaten"),
        ("key,name,food_group,is_mixed_dish\n1,a,g,maybe\n", r"line 2: is_mixed_dish is 'maybe'; give yes or no"),
        ('key,name,food_group,CA (mg)\n1,a,g,"1,5"\n', r"line 2: CA \(mg\) is '1,5', no number; .* with a point"),
        ("key,name,food_group,CA (mg)\n1,a,g,-5\n", r"line 2: CA \(mg\) is -5, which cannot be"),
        ("key,name,food_group,ENERC_KCAL (kcal)\n1,a,g,3700\n", r"line 2: ENERC_KCAL \(kcal\) is 3700: "),
        ("key,name,food_group,refuse\n1,a,g,peel\n", r"line 2: refuse 'peel' is no part with its percent"),
        ("key,name,food_group,refuse\n1,a,g,peel 60; core 40\n", r"line 2: a refuse of 100 % leaves nothing"),
        ("key,name,food_group,g_per_ml,density_source\n1,a,g,0.8,x\n", r"line 2: a density needs its density_kind"),
        ("key,name,food_group,g_per_ml,density_kind\n1,a,g,,solid\n", r"line 2: .* but no g_per_ml"),
        ("key,name,food_group,g_per_ml,density_kind\n1,a,g,800,solid\n", r"line 2: g_per_ml is 800, which no food has"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_file_line_and_column(table, text, message):
    with pytest.raises(ImportFileError, match=message):
        read(table(text))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"densities.csv": DENSITIES + "Z,1,solid,own\n"}, r"densities.csv, line 4: food 'Z' is none of foods.csv"),
        ({"densities.csv": DENSITIES + "A,,solid,own\n"}, r"densities.csv, line 4: g_per_ml is empty"),
        ({"densities.csv": "key,g_per_ml,density_kind,density_source,mood\n"}, r"densities.csv, line 1: unknown"),
        ({"portions.csv": "key,amount,measure\n"}, r"portions.csv, line 1: no column mass_g"),
        ({"portions.csv": PORTIONS + "B,0,cup,10\n"}, r"portions.csv, line 4: amount and mass_g are more than 0"),
    ],
)  # fmt: skip
def test_files_beside_are_checked_too(tmp_path, changed, message):
    files = {"foods.csv": FOODS, "densities.csv": DENSITIES, "portions.csv": PORTIONS, **changed}
    with pytest.raises(ImportFileError, match=message):
        read(write_folder(tmp_path / "folder", files))
    with pytest.raises(ImportFileError, match=r"table.zip: it holds no foods.csv"):
        read(write_zip(tmp_path / "table.zip", {"densities.csv": DENSITIES}))


@pytest.mark.parametrize("name", ["", "a:b", "Cofid", "sr28", "x" * 51])
def test_name_that_would_clash_or_break_keys_is_refused(table, name):
    with pytest.raises(InvalidInputError, match="name cannot be"):
        read(table(FOODS), name=name)
