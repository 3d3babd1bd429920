"""Components by what they are, as a reader looks for them: energy and macronutrients, vitamins, fatty acids ..."""

import re
from collections.abc import Iterable
from types import MappingProxyType
from typing import Final, TypeVar

T = TypeVar("T")

OTHERS: Final = "Others"
COMPONENT_GROUPS: Final = MappingProxyType(
    {
        "Energy and macronutrients": (
            *("208", "958", "957", "268", "203", "257", "202", "204", "205", "205.2", "CHOAVL", "CHOAVLM", "CHOAVLDF"),
            *("269", "539", "291", "FIB-", "606", "645", "646", "605", "601", "221", "255", "207"),
        ),
        "Minerals": (
            *("307", "306", "301", "303", "304", "305", "309", "312", "315", "317", "314", "313", "310", "316", "302"),
        ),
        "Vitamins": (
            *("401", "404", "405", "406", "NIAEQ", "410", "415", "416", "417", "431", "432", "435", "FOLSUM", "418"),
            *("578", "320", "VITA", "318", "319", "321", "CARTBEQ", "322", "334", "337", "338", "328", "324", "325"),
            *("326", "323", "VITE", "573", "341", "342", "343", "344", "345", "346", "347", "430", "428", "429"),
            *("421", "454"),
        ),
        "Starch and single sugars": ("209", "210", "211", "212", "287", "213", "214"),
        "Amino acids": (
            *("501", "502", "503", "504", "505", "506", "507", "508", "509", "510", "511", "512", "513", "514", "515"),
            *("516", "517", "518", "521"),
        ),
        "Sterols": ("636", "638", "639", "641"),
        "Stimulants": ("262", "263"),
    }
)
FATTY_ACIDS: Final = "Fatty acids"
_FATTY_ACID = re.compile(r"\d+:\d|Fatty acids")  # named by carbons and double bonds: "18:3 n-3 c,c,c (ALA)"
_PLACE = {number: (group, place) for group, numbers in COMPONENT_GROUPS.items() for place, number in enumerate(numbers)}
_ORDER = (*COMPONENT_GROUPS, FATTY_ACIDS, OTHERS)


def component_group(number: str, name: str) -> str:
    """The group of a component, by its source's number and its name."""
    if number in _PLACE:
        return _PLACE[number][0]
    return FATTY_ACIDS if _FATTY_ACID.match(name) else OTHERS


def by_component_group(components: Iterable[tuple[str, str, T]]) -> dict[str, list[T]]:
    """(number, name, what it has) of each -> group -> what its components have, in a reader's order."""
    found: dict[str, list[tuple[int, T]]] = {group: [] for group in _ORDER}
    for number, name, what in components:
        found[component_group(number, name)].append((_PLACE.get(number, ("", 0))[1], what))
    return {
        group: [what for _, what in sorted(members, key=lambda member: member[0])]
        for group, members in found.items()
        if members
    }
