"""A food as the texts of a form's fields, and the changed texts as the API's body.

The body holds only what differs from the version with which the form was opened, so that saving
does not undo what others have corrected meanwhile.
"""

import re
from collections.abc import Callable, Iterator, Mapping

from app.dashboard.forms import (
    WrongFieldError,
    entries,
    lines,
    number,
    read_fields,
    shown,
    text_of,
)
from app.foods.edits.edit_food import FoodVersion
from app.nutrition.components import COMPONENT_BY_NUMBER

NUTRIENT = "nutrient-"
ADDED_ROWS = 4  # empty rows for components without a figure
DENSITY_PARTS = ("g_per_ml", "sd_g_per_ml", "state", "kind", "basis", "weighs", "source")
INGREDIENT_PARTS = ("food", "mass", "state", "retention", "source")

Texts = dict[str, str]
_INGREDIENT = re.compile(rf"(?:{'|'.join(INGREDIENT_PARTS)})-(?P<place>\d{{1,3}})")


def texts_of(version: FoodVersion) -> Texts:
    """Return field -> text."""
    food, recipe = version.value, version.recipe
    texts = {
        **{name: getattr(food, name) or "" for name in ("name", "form", "slice_form", "state")},
        "aliases": "\n".join(food.aliases),
        "group": food.food_group,
        "is_mixed_dish": "true" if food.is_mixed_dish else "false",
        "probes": " ".join(food.probes),
        "source_ids": text_of(food.source_ids.items()),
        "refuse": text_of(
            (part.part, part.percent, "yes" if part.is_served else "no") for part in food.refuse
        ),
        "portions": text_of(
            (portion.amount, portion.measure, portion.mass_g) for portion in food.portions
        ),
        "densities": text_of(
            [getattr(density, part) for part in DENSITY_PARTS] for density in food.densities
        ),
        "yield_factor": shown(recipe.recipe_yield) if recipe is not None else "",
    }
    for place, part in enumerate(recipe.ingredients if recipe is not None else ()):
        texts |= {
            f"food-{place}": part.food_key,
            f"mass-{place}": shown(part.mass_g),
            f"state-{place}": version.states.get(part.food_id) or "",
            f"retention-{place}": ", ".join(
                f"{name} {shown(share)}" for name, share in part.retention.items()
            ),
            f"source-{place}": part.retention_source or "",
        }
    return texts | {
        f"{NUTRIENT}{number_}": shown(content) for number_, content in food.per_100_g.items()
    }


def changed_fields(entered: Mapping[str, str], base: Texts) -> frozenset[str]:
    """Return the fields whose text differs from the base version's; a field that was not sent is unchanged."""
    sent = [name for name in entered if name in base or is_of_recipe(name)]
    return frozenset(
        name for name in sent if _normalised(entered[name]) != _normalised(base.get(name, ""))
    )


def body_of(
    entered: Mapping[str, str], changed: frozenset[str], units: Mapping[str, str]
) -> tuple[dict[str, object], dict[str, str]]:
    """Return (values of a FoodPatch for the changed fields, field -> why it cannot be read).

    units: component -> unit of the figures that the form shows.
    """
    texts = {name: entered.get(name, "") for name in changed}
    body, wrong = read_fields(texts, _READERS)
    figures = [  # field, component, figure, unit
        (
            name,
            component,
            texts[name],
            units.get(component) or COMPONENT_BY_NUMBER[component].unit.value,
        )
        for name in changed
        if (component := name.removeprefix(NUTRIENT)) != name
    ]
    for place in range(ADDED_ROWS):
        component, figure, unit = (
            entered.get(f"{part}-{place}", "") for part in ("add", "figure", "unit")
        )
        if component and figure:
            figures.append((f"figure-{place}", component, figure, unit))
        elif component or figure:
            wrong[f"figure-{place}"] = "Name both the component and its figure."
    nutrients: dict[str, object] = {}
    for field, component, figure, unit in figures:
        try:  # an emptied field means that the figure is not known
            nutrients[component] = {"per_100_g": number(figure), "unit": unit} if figure else None
        except WrongFieldError as error:
            wrong[field] = str(error)
    if nutrients:
        body["nutrients"] = nutrients
    if any(is_of_recipe(name) for name in changed):
        try:
            body["recipe"] = _recipe(entered)
        except WrongFieldError as error:
            wrong["recipe"] = str(error)
    return body, wrong


def is_of_recipe(field: str) -> bool:
    """Whether a field belongs to the recipe."""
    return field == "yield_factor" or _INGREDIENT.fullmatch(field) is not None


def ingredient_rows(entered: Mapping[str, object]) -> int:
    """Return the number of ingredient rows, up to the last one that is not empty."""
    matches = (_INGREDIENT.fullmatch(name) for name, text in entered.items() if text)
    return max((int(match["place"]) + 1 for match in matches if match is not None), default=0)


def _normalised(text: str) -> str:
    return "\n".join(line.strip() for line in text.strip().splitlines())


def _densities(text: str) -> list[dict[str, object]]:
    return [
        {**row, "g_per_ml": number(row["g_per_ml"]), "sd_g_per_ml": number(row["sd_g_per_ml"])}
        for row in entries(text, DENSITY_PARTS)
    ]


def _refuse(text: str) -> list[dict[str, object]]:
    return [
        {
            "part": row["part"],
            "percent": number(row["percent"]),
            "is_served": _is_yes(row.get("is_served", "yes")),
        }
        for row in entries(text, ("part", "percent", "is_served"), needed=2)
    ]


def _is_yes(text: str) -> bool:
    if text.lower() not in ("yes", "no", ""):
        raise WrongFieldError(f"“{text[:40]}”: write yes or no.")
    return text.lower() != "no"


def _portions(text: str) -> list[dict[str, object]]:
    return [_portion(line) for line in lines(text)]


def _portion(line: str) -> dict[str, object]:
    """Read amount; measure; mass_g. The measure may contain semicolons."""
    amount, first, rest = line.partition(";")
    measure, last, mass = rest.rpartition(";")
    if not first or not last:
        raise WrongFieldError(f"“{line[:40]}” needs: amount; measure; mass_g.")
    return {
        "amount": number(amount.strip()),
        "measure": measure.strip(),
        "mass_g": number(mass.strip()),
    }


def _source_ids(text: str) -> dict[str, str]:
    return {row["system"]: row["code"] for row in entries(text, ("system", "code"))}


def _recipe(entered: Mapping[str, str]) -> dict[str, object] | None:
    """Return the recipe; None removes it: all rows are empty."""
    ingredients = list(_ingredients(entered))
    if not ingredients:
        return None
    return {"yield_factor": number(entered.get("yield_factor", "")), "ingredients": ingredients}


def _ingredients(entered: Mapping[str, str]) -> Iterator[dict[str, object]]:
    for place in range(ingredient_rows(entered)):
        row = {part: entered.get(f"{part}-{place}", "") for part in INGREDIENT_PARTS}
        if not row["food"]:
            if any(row[part] for part in ("mass", "retention", "source")):
                raise WrongFieldError(f"Ingredient {place + 1} names no food.")
            continue
        ingredient: dict[str, object] = {
            "food": row["food"],
            "mass_g": number(row["mass"]),
            "state": row["state"],
        }
        if row["retention"]:
            ingredient["retention"] = dict(_share(text) for text in row["retention"].split(","))
        if row["source"]:
            ingredient["retention_source"] = row["source"]
        yield ingredient


def _share(text: str) -> tuple[str, float]:
    name, _, share = text.strip().rpartition(" ")
    if not name:
        raise WrongFieldError(
            f"“{text[:40]}”: write a component and the share of it that is kept, such as VITC 0.75."
        )
    return name.strip(), number(share)


_READERS: Mapping[str, Callable[[str], object]] = {
    **dict.fromkeys(("name", "group", "form"), str),
    "aliases": lines,
    **dict.fromkeys(("slice_form", "state"), lambda text: text or None),
    "is_mixed_dish": lambda text: text == "true",
    "probes": str.split,
    "source_ids": _source_ids,
    "refuse": _refuse,
    "portions": _portions,
    "densities": _densities,
}
