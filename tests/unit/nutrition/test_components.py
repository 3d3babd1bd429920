import zipfile

from app.nutrition.components import (
    COMPONENT_BY_NUMBER,
    COMPONENT_GROUPS,
    COMPONENTS,
    FATTY_ACIDS,
    HEADLINES,
    OTHERS,
    by_component_group,
    component_group,
)


def test_number_name_unit_and_tagname_agree_with_the_release(shared_data):
    with zipfile.ZipFile(shared_data / "food_tables" / "sr28asc.zip") as archive:
        lines = archive.read("NUTR_DEF.txt").decode("cp1252").splitlines()
    published = [[field.strip("~") for field in line.split("^")] for line in lines]
    assert len(published) == 150
    for number, unit, tagname, name, *_ in published:
        component = COMPONENT_BY_NUMBER[number]
        assert (component.name, component.tagname or "") == (name, tagname)
        assert component.unit.value == unit.replace("\u00b5", "u")


def test_headline_column_ends_with_the_unit_of_its_components():
    for headline in HEADLINES:
        assert {COMPONENT_BY_NUMBER[number].unit.value for number in headline.numbers} == {headline.unit}


def test_every_component_has_a_group_and_energy_comes_first():
    groups = {component_group(component.number, component.name) for component in COMPONENTS}
    assert groups == {*COMPONENT_GROUPS, FATTY_ACIDS}
    grouped = by_component_group((one.number, one.name, one.number) for one in reversed(COMPONENTS))
    assert sorted(number for numbers in grouped.values() for number in numbers) == sorted(COMPONENT_BY_NUMBER)
    assert grouped["Energy and macronutrients"][0] == "208"
    assert component_group("X1", "A component of a national table") == OTHERS
    assert component_group("851", "18:3 n-3 c,c,c (ALA)") == "Fatty acids"
