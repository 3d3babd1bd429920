"""A measured density as it is typed: two figures, or the specimens, one a line; for a food and for a study's own."""

from collections.abc import Mapping
from typing import Any

from app.dashboard.line_fields import WrongFieldError, lines, number

NUMBERS = ("g_per_ml", "sd_g_per_ml", "volume_step_ml")
WORDS = ("state", "kind", "weighs", "method", "reason")


def density_values(typed: Mapping[str, str]) -> tuple[dict[str, Any], dict[str, str]]:
    """(the fields of a MeasuredDensityIn that are told, field -> why it cannot be read)."""
    values: dict[str, Any] = {name: typed[name] for name in WORDS if typed.get(name)}
    wrong: dict[str, str] = {}
    for name in NUMBERS:
        if typed.get(name):
            try:
                values[name] = number(typed[name])
            except WrongFieldError as error:
                wrong[name] = str(error)
    try:
        specimens = [_specimen(line) for line in lines(typed.get("specimens", ""))]
    except WrongFieldError as error:
        wrong["specimens"] = str(error)
    else:
        if specimens:
            values["specimens"] = specimens
    return values, wrong


def _specimen(line: str) -> dict[str, float]:
    parts = line.replace(";", " ").split()
    if len(parts) != 2:
        raise WrongFieldError(f"“{line[:40]}”: write the volume in ml and the mass in g, with a blank between.")
    return {"volume_ml": number(parts[0]), "mass_g": number(parts[1])}
