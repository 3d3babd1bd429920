from app.core.units import Unit
from app.nutrition.components import COMPONENT_BY_NUMBER, COMPONENTS, HEADLINE_NUMBERS, NUMBER_BY_TAGNAME


def test_numbers_are_unique():
    assert len(COMPONENT_BY_NUMBER) == len(COMPONENTS)


def test_tagname_belongs_to_one_number_but_where_the_unit_differs():
    for component in COMPONENTS:
        if component.tagname is not None and NUMBER_BY_TAGNAME[component.tagname] != component.number:
            assert component.unit == Unit.IU, component


def test_each_of_the_ten_headline_components_has_a_number():
    assert len(HEADLINE_NUMBERS) == 10
    assert all(number in COMPONENT_BY_NUMBER for numbers in HEADLINE_NUMBERS for number in numbers)


def test_energy_of_foundation_foods_counts_where_208_is_missing():
    assert HEADLINE_NUMBERS[0] == ("208", "958", "957")


def test_neighbouring_expressions_stay_apart():
    tagnames = {number: component.tagname for number, component in COMPONENT_BY_NUMBER.items()}
    assert (tagnames["417"], tagnames["435"], tagnames["431"]) == ("FOL", "FOLDFE", "FOLAC")
    assert tagnames["205"] == "CHOCDF"
    assert NUMBER_BY_TAGNAME["CHOAVL"] != NUMBER_BY_TAGNAME["CHOCDF"]
    assert NUMBER_BY_TAGNAME["VITD"] == "328"  # ug; 324 is the same vitamin in IU
    assert COMPONENT_BY_NUMBER["324"].unit == Unit.IU


def test_number_name_unit_and_tagname_agree_with_the_release(sr28_folder):
    lines = (sr28_folder / "NUTR_DEF.txt").read_text(encoding="cp1252").splitlines()
    published = [[field.strip("~") for field in line.split("^")] for line in lines]
    assert len(published) == 150
    for number, unit, tagname, name, *_ in published:
        component = COMPONENT_BY_NUMBER[number]
        assert (component.name, component.tagname or "") == (name, tagname)
        assert component.unit.value == unit.replace("\u00b5", "u")
