"""Groups of foods as foods of the table: the means of their members, and a spread that covers them.

What is sure of an orange or a lemon is that it is citrus fruit. Its grams and nutrients are then
those of the mean member. The spread of its density is that of the energy in a millilitre from
member to member, beside each member's own: the interval of the energy, which studies ask for most,
is then honest, and that of the grams wider than it need be.
"""

import statistics
from collections.abc import Mapping, Sequence
from math import hypot, sqrt
from typing import Any

from app.nutrition.density import KIND_OF_FORM

ENERGY = "208"  # kcal


def food_group(
    entry: Mapping[str, Any],
    foods: Mapping[str, dict[str, Any]],
    contents: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    """Return a group of the selection as a food of foods.json.

    foods, contents: by key, of its members too. Raises ValueError if fewer than two have a density.
    """
    kind = KIND_OF_FORM[entry["form"]]
    members = [foods[key] for key in entry["members"]]
    found = [
        (member["key"], *density[:2], _edible_share(member))
        for member in members
        if (density := next((each for each in member["densities"] if each[3] == kind), None))
    ]
    if len(found) < 2:
        raise ValueError(f"{entry['key']}: fewer than two members have a {kind} density")
    energies = [g_per_ml * share * contents[key][ENERGY] for key, g_per_ml, _, share in found]
    between = statistics.stdev(energies) / statistics.mean(energies)
    within = sqrt(statistics.mean((sd / g_per_ml) ** 2 for _, g_per_ml, sd, _ in found))
    g_per_ml = statistics.mean(each[1] for each in found)
    refuse = 100.0 * (1.0 - statistics.mean(_edible_share(member) for member in members))
    groups = [member["food_group"] for member in members]
    return {
        "key": entry["key"],
        "name": entry["name"],
        "aliases": entry["aliases"],
        "food_group": max(dict.fromkeys(groups), key=groups.count),
        "form": entry["form"],
        "slice_form": None,
        "refuse": [["not eaten, mean of the group", round(refuse, 1), True]] if refuse > 0 else [],
        "densities": [
            [
                round(g_per_ml, 3),
                round(g_per_ml * hypot(between, within), 3),
                "as its members",
                kind,
                "group",
                f"mean of {len(found)} foods of this group, spread of their energy per ml",
                "as_seen",
            ]
        ],
        "source_ids": {"members": " ".join(entry["members"])},
        "state": members[0]["state"],
        "is_mixed_dish": all(member["is_mixed_dish"] for member in members),
        "portions": [],
        "probes": [],
    }


def mean_contents(members: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means of the components that all members have, per 100 g."""
    known = [number for number in members[0] if all(number in each for each in members)]
    return {
        number: float(f"{statistics.mean(each[number] for each in members):.4g}")
        for number in known
    }


def _edible_share(food: Mapping[str, Any]) -> float:
    """Of what lies on the plate."""
    return 1.0 - sum(float(part[1]) for part in food["refuse"] if part[2]) / 100.0
