"""The fields of a measured density in a form: two figures, or specimens, one per line. For foods and for studies."""

from collections.abc import Callable, Mapping

from app.dashboard.meal_pages.line_fields import WrongFieldError, lines, number, read_fields


def density_values(texts: Mapping[str, str]) -> tuple[dict[str, object], dict[str, str]]:
    """Return (values of a MeasuredDensityIn for the fields that are not empty, field -> why it cannot be read)."""
    return read_fields({name: text for name, text in texts.items() if text}, _READERS)


def _specimens(text: str) -> list[dict[str, float]]:
    return [_specimen(line) for line in lines(text)]


def _specimen(line: str) -> dict[str, float]:
    parts = line.replace(";", " ").split()
    if len(parts) != 2:
        raise WrongFieldError(
            f"“{line[:40]}”: write the volume in ml and the mass in g, with a blank between."
        )
    return {"volume_ml": number(parts[0]), "mass_g": number(parts[1])}


_READERS: Mapping[str, Callable[[str], object]] = {
    **dict.fromkeys(("g_per_ml", "sd_g_per_ml", "volume_step_ml"), number),
    **dict.fromkeys(("state", "kind", "weighs", "method", "reason"), str),
    "specimens": _specimens,
}
