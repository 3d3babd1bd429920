from app.nutrition.components import (
    COMPONENT_BY_TAGNAME,
    COMPONENTS,
    HEADLINE_COMPONENTS,
    TAGNAME_BY_SR28_NUMBER,
)
from app.nutrition.importers.sr28 import Sr28Release


def test_tagnames_and_numbers_are_unique():
    assert len(COMPONENT_BY_TAGNAME) == len(TAGNAME_BY_SR28_NUMBER) == len(COMPONENTS)


def test_the_ten_headline_components_are_known():
    assert len(HEADLINE_COMPONENTS) == 10
    assert set(HEADLINE_COMPONENTS) <= set(COMPONENT_BY_TAGNAME)


def test_neighbouring_expressions_stay_apart():
    assert TAGNAME_BY_SR28_NUMBER["417"] == "FOL"
    assert TAGNAME_BY_SR28_NUMBER["435"] == "FOLDFE"
    assert TAGNAME_BY_SR28_NUMBER["205"] == "CHOCDF"
    assert "CHOAVL" not in COMPONENT_BY_TAGNAME
    assert "324" not in TAGNAME_BY_SR28_NUMBER  # vitamin D in IU, which SR28 tags VITD like 328 in ug


def test_tagname_unit_and_name_agree_with_the_release(shared_data):
    published = Sr28Release(shared_data / "food_tables" / "sr28asc.zip").nutrient_definitions()
    for component in COMPONENTS:
        assert published[component.sr28_number] == (component.tagname, component.name, component.unit.value)
