"""Grams of an amount as it stands: as a person set them, else by volume and density."""

from app.foods.food_amounts import Weighing, mass_of
from app.meals.item_state import Amount
from app.nutrition.mass import Mass, weighed_mass


def served_mass(weighing: Weighing, amount: Amount) -> Mass | None:
    """The mass of a helping, or of what was left of one by its item's own density; None where it is not known."""
    if amount.mass is not None:
        is_edible = amount.mass.of == "edible"
        share = weighing.edible_share
        return weighed_mass(amount.mass.mass_g, amount.mass.relative_sd, is_edible=is_edible, edible_share=share)
    return mass_of(weighing, amount.volume_ml, amount.relative_sd)
