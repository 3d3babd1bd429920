import zipfile

from app.core.units import Unit
from app.nutrition.components import (
    COMPONENT_BY_NUMBER,
    COMPONENT_GROUPS,
    COMPONENTS,
    FATTY_ACIDS,
    HEADLINE_NUMBERS,
    NUMBER_BY_TAGNAME,
    OTHERS,
    by_component_group,
    component_group,
)


def test_numbers_are_unique_and_a_tagname_belongs_to_one_but_where_the_unit_differs():
    assert len(COMPONENT_BY_NUMBER) == len(COMPONENTS)
    for component in COMPONENTS:
        if component.tagname is not None and NUMBER_BY_TAGNAME[component.tagname] != component.number:
            assert component.unit == Unit.IU, component


def test_each_of_the_ten_headline_components_has_a_number_and_energy_those_of_foundation_foods_too():
    assert len(HEADLINE_NUMBERS) == 10
    assert all(number in COMPONENT_BY_NUMBER for numbers in HEADLINE_NUMBERS for number in numbers)
    assert HEADLINE_NUMBERS[0] == ("208", "958", "957")


def test_neighbouring_expressions_stay_apart():
    tagnames = {number: component.tagname for number, component in COMPONENT_BY_NUMBER.items()}
    assert (tagnames["417"], tagnames["435"], tagnames["431"]) == ("FOL", "FOLDFE", "FOLAC")
    assert tagnames["205"] == "CHOCDF"
    assert NUMBER_BY_TAGNAME["CHOAVL"] != NUMBER_BY_TAGNAME["CHOCDF"]
    assert NUMBER_BY_TAGNAME["VITD"] == "328"  # ug; 324 is the same vitamin in IU
    assert COMPONENT_BY_NUMBER["324"].unit == Unit.IU


def test_number_name_unit_and_tagname_agree_with_the_release(shared_data):
    with zipfile.ZipFile(shared_data / "food_tables" / "sr28asc.zip") as archive:
        lines = archive.read("NUTR_DEF.txt").decode("cp1252").splitlines()
    published = [[field.strip("~") for field in line.split("^")] for line in lines]
    assert len(published) == 150
    for number, unit, tagname, name, *_ in published:
        component = COMPONENT_BY_NUMBER[number]
        assert (component.name, component.tagname or "") == (name, tagname)
        assert component.unit.value == unit.replace("\u00b5", "u")


def test_every_component_has_a_group_and_energy_comes_first():
    groups = {component_group(component.number, component.name) for component in COMPONENTS}
    assert groups == {*COMPONENT_GROUPS, FATTY_ACIDS}
    grouped = by_component_group((one.number, one.name, one.number) for one in reversed(COMPONENTS))
    assert sorted(number for numbers in grouped.values() for number in numbers) == sorted(COMPONENT_BY_NUMBER)
    assert grouped["Energy and macronutrients"][0] == "208"
    assert component_group("X1", "A component of a national table") == OTHERS
    assert component_group("851", "18:3 n-3 c,c,c (ALA)") == "Fatty acids"
