"""Foods for tests: plausible, small, with only the named parts of interest."""

from app.nutrition.components import NUMBER_BY_TAGNAME
from app.nutrition.foods import Density, Food, RefusePart


def make_density(g_per_ml=1.0, sd=0.05, kind="solid", basis="measured", state="raw"):
    return Density(g_per_ml, sd, state, kind, basis, f"a test's {basis} density")


def make_food(key="apple", form="whole", densities=(), refuse=(), per_100_g=None):
    return Food(
        key=key,
        name=key.capitalize(),
        aliases=(),
        food_group="Fruits",
        form=form,
        slice_form=None,
        refuse=tuple(RefusePart(*part) for part in refuse),
        densities=tuple(densities),
        per_100_g={NUMBER_BY_TAGNAME[tagname]: content for tagname, content in (per_100_g or {}).items()},
        source_ids={},
    )
