"""Components by group: each that we know has a place, and the order is a reader's."""

from app.nutrition.components import (
    COMPONENT_BY_NUMBER,
    COMPONENT_GROUPS,
    COMPONENTS,
    FATTY_ACIDS,
    OTHERS,
    by_component_group,
    component_group,
)


def test_every_component_has_a_group_and_each_named_one_is_known():
    assert len(COMPONENT_BY_NUMBER) == len(COMPONENTS), "none stands in two"
    groups = {component_group(component.number, component.name) for component in COMPONENTS}
    assert groups == {*COMPONENT_GROUPS, FATTY_ACIDS}


def test_groups_keep_all_and_put_energy_first():
    grouped = by_component_group((one.number, one.name, one.number) for one in reversed(COMPONENTS))
    assert sorted(number for numbers in grouped.values() for number in numbers) == sorted(COMPONENT_BY_NUMBER)
    assert grouped["Energy and macronutrients"][0] == "208"
    assert component_group("X1", "A component of a national table") == OTHERS
    assert component_group("851", "18:3 n-3 c,c,c (ALA)") == "Fatty acids"
