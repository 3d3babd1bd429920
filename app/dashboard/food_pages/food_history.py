"""Changes of a food as readable lines: field, old value, new value."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.foods.models import Component as ComponentRow
from app.foods.queries import NutrientRow
from app.nutrition.components import COMPONENT_BY_NUMBER, Component

NOT_KNOWN = "not known"
NONE = "none"


@dataclass(frozen=True, slots=True)
class Difference:
    """A changed field of a food. unit: of figures, else empty."""

    label: str
    old: str
    new: str
    unit: str = ""


def describe_differences(
    differences: Mapping[str, Sequence[object]], rows: Iterable[NutrientRow] = ()
) -> list[Difference]:
    """Describe field -> (old, new), nutrient figures last. rows: name components that components.csv lacks."""
    components: dict[str, Component | ComponentRow] = {
        row.component.number: row.component for row in rows
    }
    components |= COMPONENT_BY_NUMBER
    changed, figures = [], []
    for name, (old, new) in differences.items():
        number = name.removeprefix("nutrients.")
        if number != name:
            component = components.get(number)
            label, unit = (
                (component.name, str(component.unit)) if component is not None else (number, "")
            )
            figures.append(Difference(label, _figure(old), _figure(new), unit))
        else:
            changed.append(
                Difference(
                    name.replace("_", " ").capitalize(), _describe(name, old), _describe(name, new)
                )
            )
    return changed + figures


def _figure(value: object) -> str:
    return NOT_KNOWN if value is None else repr(value)


def _describe(field: str, value: Any) -> str:
    if value is None or value in ("", [], {}):
        return NONE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return "; ".join(_part(field, part) for part in value)
    if field == "recipe":
        parts = "; ".join(_part("ingredients", part) for part in value["ingredients"])
        return f"yield {value['yield']}: {parts}"
    if isinstance(value, dict):
        return "; ".join(f"{name} {part}" for name, part in value.items())
    return str(value)


def _part(field: str, part: Any) -> str:
    if field == "densities":
        return (
            f"{part['g_per_ml']} ± {part['sd_g_per_ml']} g/ml, {part['kind']}, {part['state']} "
            f"({part['basis']}: {part['source']})"
        )
    if field == "refuse":
        return f"{part['part']} {part['percent']} %{'' if part['is_served'] else ', removed before serving'}"
    if field == "portions":
        return f"{part['amount']} {part['measure']} = {part['mass_g']} g"
    if field == "ingredients":
        retained = ", ".join(f"{number} {share}" for number, share in part["retention"].items())
        return f"{part['mass_g']} g {part['food_key']}" + (
            f" (keeps {retained})" if retained else ""
        )
    return str(part)
