"""Infer the usual form on the plate and the state of a food of an imported table from its group and name.

Published tables state neither. The inference is a judgement: a curated table (the starter's, a
study's own) is better, and a person who knows the item overrules it. The patterns are for USDA's
food names and groups.
"""

import re
from collections.abc import Callable, Mapping

from app.nutrition.foods import DensityKind, FoodForm, FoodState


def _words(alternatives: str) -> re.Pattern[str]:
    return re.compile(rf"\b(?:{alternatives})\b", re.IGNORECASE)


_UNCOOKED = _words("raw|uncooked|unprepared|unheated|dry|fresh|unpopped|dough")
_COOKED = _words(
    "cooked|boiled|baked|roasted|fried|broiled|braised|grilled|stewed|steamed|microwaved|toasted|heated|simmered|"
    "poached|scrambled|hard-boiled|pan-fried|pan-broiled|barbecued|rotisserie|prepared|blanched|sauteed"
)
_POWDER = _words("powder|powdered|dry|mix|dehydrated|granules|flour|instant")
_DRINK = _words(
    "juices?|nectar|drinks?|beverage|coffee|tea|water|beer|wine|ale|cider|shake|milkshake|smoothie|soda|cola|"
    "lemonade|eggnog|cocoa|liqueur|whiskey|vodka"
)
_JUICE = _words("juices?|smoothie|drink")
# What a food is packed in or made with is not the food: pineapple in juice is not juice, ham with
# water not water.
_PACKED_IN = re.compile(
    r"\b(?:(?:in|with|from|plus|of)\s[^,]*|(?:juice|water|syrup) pack(?:ed)?\b|water[- ]added|added water)",
    re.IGNORECASE,
)
_POURED = _words(
    "milk|cream|yogurt|buttermilk|whey|kefir|oil|syrups?|honey|molasses|vinegar|sauce|gravy|dressing|ketchup|"
    "catsup|mustard|jams?|jelly|jellies|preserves|marmalade|strained|junior"
)
_FIRM = _words("cheese|butter|margarine|shortening|lard|tallow|chocolate|bars?|tofu|tempeh")
_ICE_CREAM = _words("ice creams?|sherbet|frozen yogurts?")
_IN_THE_HAND = _words("sandwich|bars?|cone")
_PACKS = _words(
    "peanut butter|almond butter|cashew butter|sunflower seed butter|sesame butter|tahini|spread|frostings?|"
    "icings?|puddings?|toppings?|hummus|paste|puree|cream cheese|custard"
)
_ROUND_BREAD = _words("rolls?|buns?|muffins?|bagels?|doughnuts?|biscuits?|scones?|croissants?")
_HANDHELD = _words(
    "pizza|sandwich(?:es)?|hamburger|cheeseburger|burger|burritos?|tacos?|enchiladas?|quesadilla|hotdog|submarine|"
    "lasagna|pie|pot pie|egg rolls?|tamales?|pupusas?|wrap|biscuit|croissant|corndog|frankfurter|fillet|steak|"
    "ribs?|patty|breast|drumstick|wing|thigh|sub|whopper|big mac|quarter pounder|filet-o-fish|mcmuffin|mcgriddles"
)
_NO_DISH = re.compile(r"\bburger king\b", re.IGNORECASE)
_SMALL_FRUIT = _words(
    "blueberries|raspberries|strawberries|blackberries|cranberries|grapes|cherries|raisins|currants|gooseberries|"
    "mulberries|elderberries|olives|dates|berries"
)
_CUT = _words(
    "canned|frozen|dried|sliced|cut|stewed|sauce|dehydrated|chunks|salad|chopped|mashed|candied"
)
_ON_THE_COB = _words("on cob|on the cob")
_FREED = _words("meat only|hard-boiled")
_PITS = _words("pits?|stones?")
_WHOLE_VEGETABLE = re.compile(
    r"^(?:tomato|tomatoes|potato|potatoes|sweet potato|avocados?|corn)\b", re.IGNORECASE
)
_MINCED = _words("crumbles|ground|minced|shredded|flaked|canned")
_WHOLE_EGG = re.compile(r"^egg, (?:whole|duck|goose|quail|turkey)", re.IGNORECASE)
_LOOSE_DAIRY = _words("cottage|ricotta|scrambled|grated|shredded")
_WHIPPED_OR_DRIED = _words("whipped|topping|pressurized|dried|whip")
_DISH = _words(
    "pizza|sandwich(?:es)?|hamburger|cheeseburger|burrito|taco|enchilada|quesadilla|lasagna|casserole|stew|chili|"
    "with .* sauce|pot pie|egg rolls?|fried rice|macaroni and cheese|potato salad|coleslaw|chow mein|lo mein|"
    "tamales?|ravioli|submarine|nachos|burger|dumplings?|chicken tenders|curry|paella|risotto|sushi"
)
_SOYMILK = _words("soymilk|soy milk|soy beverage")
_MEATLESS = _words("meatless|veggie|vegetarian|patty|patties")
_DISH_GROUPS = ("fast foods", "restaurant foods")


def usual_state(name: str) -> FoodState:
    """Return whether a food is raw (dry goods and dough too), cooked or as_eaten, by its name.

    "uncooked" and "dry" take precedence over "cooked": "Rice, white, long-grain, parboiled, dry".
    """
    if _UNCOOKED.search(name):
        return "raw"
    return "cooked" if _COOKED.search(name) else "as_eaten"


def usual_form(name: str, group: str) -> FoodForm:
    """Return the most common form of a portion of the food on a plate or in a glass."""
    group_name = group.lower()
    if _POWDER.search(name) and not _COOKED.search(name) and not group_name.startswith("baked"):
        return "heap"
    for prefix, form_of in _FORM_OF_GROUP.items():
        if group_name.startswith(prefix):
            return form_of(name)
    return _dish(name)


def is_mixed_dish(name: str, group: str) -> bool:
    """Return whether the food is a dish of several foods, as eaten."""
    group_name = group.lower()
    if "meals, entrees" in group_name or "mixed dish" in group_name:
        return True
    return group_name.startswith(_DISH_GROUPS) and _DISH.search(name) is not None


def is_served(part: str, name: str, form: FoodForm) -> bool:
    """Return whether a refuse part of a food of this name is usually on the plate.

    A piece has its peel, core and bone, unless the name excludes them ("meat only"). Food in a heap
    was trimmed, podded, shelled or cut first, so only pits remain.
    """
    if _FREED.search(name):
        return False
    return form not in {"heap", "in_vessel"} or _PITS.search(part) is not None


def cup_kind(name: str, group: str, form: FoodForm) -> DensityKind | None:
    """Return the kind of density of a plain cup or spoon of the food, if it differs from the usual one for cups.

    A cup of butter or of peanut butter contains no air: its weight gives the density of a slab.
    """
    if form in {"whole", "lying", "slab"} and (
        group.lower().startswith("fats") or _PACKS.search(name)
    ):
        return "solid"
    return None


def _meat(name: str) -> FoodForm:
    return "heap" if _MINCED.search(name) and "patty" not in name.lower() else "slab"


def _baked(name: str) -> FoodForm:
    if name.lower().startswith("leavening"):
        return "heap"
    return "whole" if _ROUND_BREAD.search(name) else "slab"


def _cereal(name: str) -> FoodForm:
    return "slab" if _IN_THE_HAND.search(name) else "heap"


def _beverage(_: str) -> FoodForm:
    return "liquid"


def _soup(name: str) -> FoodForm:
    return "liquid" if _POURED.search(name) or _is_drink(name) else "in_vessel"


def _fruit(name: str) -> FoodForm:
    if _is_drink(name):
        return "liquid"
    return "heap" if _SMALL_FRUIT.search(name) or _CUT.search(name) else "whole"


def _vegetable(name: str) -> FoodForm:
    if _JUICE.search(_PACKED_IN.sub("", name)):
        return "liquid"
    if _ON_THE_COB.search(name):
        return "whole"
    return "whole" if _WHOLE_VEGETABLE.search(name) and not _CUT.search(name) else "heap"


def _legume(name: str) -> FoodForm:
    if _SOYMILK.search(name):
        return "liquid"
    return "slab" if _MEATLESS.search(name) or _FIRM.search(name) else _dish(name)


def _dairy(name: str) -> FoodForm:
    if _ICE_CREAM.search(name):
        return _ice_cream(name)
    if _WHOLE_EGG.match(name):
        return "whole"
    if _WHIPPED_OR_DRIED.search(name):
        return "heap"
    if name.lower().startswith("butter,") and "oil" not in name.lower():
        return "slab"
    if name.lower().startswith(("egg", "cheese")) and not _is_drink(name):
        return "heap" if _LOOSE_DAIRY.search(name) else "slab"
    return "liquid"


def _fat_or_sweet(name: str) -> FoodForm:
    if _ICE_CREAM.search(name):
        return _ice_cream(name)
    return (
        "liquid" if (_POURED.search(name) or _is_drink(name)) and not _FIRM.search(name) else "slab"
    )


def _dish(name: str) -> FoodForm:
    if _ICE_CREAM.search(name):
        return _ice_cream(name)
    if _is_drink(name):
        return "liquid"
    return "slab" if _HANDHELD.search(_NO_DISH.sub("", name)) or _FIRM.search(name) else "heap"


def _ice_cream(name: str) -> FoodForm:
    return "slab" if _IN_THE_HAND.search(name) else "heap"


def _is_drink(name: str) -> bool:
    return "salad" not in name.lower() and _DRINK.search(_PACKED_IN.sub("", name)) is not None


# Lower-case prefix of the group's name -> form.
_FORM_OF_GROUP: dict[str, Callable[[str], FoodForm]] = {
    **dict.fromkeys(("beef", "pork", "lamb", "poultry", "finfish", "sausages", "meat"), _meat),
    "baked": _baked,
    "breakfast cereals": _cereal,
    "beverages": _beverage,
    "alcoholic beverages": _beverage,
    "soup": _soup,
    "baby": _soup,
    "fruit": _fruit,
    "vegetable": _vegetable,
    "legume": _legume,
    "dairy": _dairy,
    "fats": _fat_or_sweet,
    "sweets": _fat_or_sweet,
}

# Height over width (the geometric mean of length and breadth) of pieces of the starter table's foods that are flatter
# than others of their form: from volumes and photographs from above of half of ECUSTFD's specimens (Liang and Li,
# 2017).
FOOD_HEIGHTS: Mapping[str, float] = {
    "banana": 0.55,
    "bread-white": 0.11,
    "doughnut": 0.33,
    "fried-dough-twist": 0.36,
    "mango": 0.6,
    "steamed-bun": 0.6,
}
