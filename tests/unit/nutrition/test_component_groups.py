"""Components by group: each that we know has a place, and the order is a reader's."""

from app.nutrition.components import (
    COMPONENT_BY_NUMBER,
    COMPONENT_GROUPS,
    COMPONENTS,
    OTHERS,
    by_component_group,
    component_group,
)


def test_every_component_has_a_group_and_each_named_one_is_known():
    placed = [number for numbers in COMPONENT_GROUPS.values() for number in numbers]
    assert len(placed) == len(set(placed)), "none stands in two"
    assert set(placed) <= COMPONENT_BY_NUMBER.keys()
    assert [one.name for one in COMPONENTS if component_group(one.number, one.name) == OTHERS] == []


def test_groups_keep_all_and_put_energy_first():
    grouped = by_component_group((one.number, one.name, one.number) for one in reversed(COMPONENTS))
    assert sorted(number for numbers in grouped.values() for number in numbers) == sorted(COMPONENT_BY_NUMBER)
    assert grouped["Energy and macronutrients"][0] == "208"
    assert component_group("X1", "A component of a national table") == OTHERS
    assert component_group("851", "18:3 n-3 c,c,c (ALA)") == "Fatty acids"
