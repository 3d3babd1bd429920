"""How a food of an imported table usually lies on the plate, and how it was prepared, judged by its group and its words.

Published tables say neither. A judgement, not a measurement: a curated table (the starter's, a study's own) says better,
and a person who knows the item overrules it. Words are those of USDA's food names and groups, which FoodData Central keeps.
"""

import re

from app.nutrition.foods import FoodForm, FoodState

_UNCOOKED = re.compile(r"\b(raw|uncooked|unprepared|unheated|dry|fresh|unpopped|dough)\b", re.IGNORECASE)
_COOKED = re.compile(
    r"\b(cooked|boiled|baked|roasted|fried|broiled|braised|grilled|stewed|steamed|microwaved|toasted|heated|simmered|"
    r"poached|scrambled|hard-boiled|pan-fried|pan-broiled|barbecued|rotisserie|prepared|blanched|sauteed)\b",
    re.IGNORECASE,
)

_POWDER = re.compile(r"\b(powder|powdered|dry|mix|dehydrated|granules|flour)\b", re.IGNORECASE)
_DRINK = re.compile(
    r"\b(juice|juices|nectar|drink|drinks|beverage|coffee|tea|water|beer|wine|ale|cider|shake|milkshake|smoothie|soda|cola|"
    r"lemonade|eggnog|cocoa|liqueur|whiskey|vodka)\b",
    re.IGNORECASE,
)
# What a food was packed in, or made with, is not what it is: pineapple in juice is no juice, ham with water no water.
_PACKED_IN = re.compile(
    r"\b(?:(?:in|with|from|plus|of)\s[^,]*|(?:juice|water|syrup) pack(?:ed)?\b|water[- ]added|added water)", re.IGNORECASE
)
_POURED = re.compile(
    r"\b(milk|cream|yogurt|buttermilk|whey|kefir|oil|syrup|syrups|honey|molasses|vinegar|sauce|gravy|dressing|ketchup|"
    r"catsup|mustard|jam|jams|jelly|jellies|preserves|marmalade|strained|junior)\b",
    re.IGNORECASE,
)
_FIRM = re.compile(
    r"\b(cheese|butter|margarine|shortening|lard|tallow|chocolate|bar|bars|tofu|tempeh)\b", re.IGNORECASE
)
_JUICE = re.compile(r"\b(juice|juices|smoothie|drink)\b", re.IGNORECASE)
_ICE_CREAM = re.compile(r"\b(ice creams?|sherbet|frozen yogurts?)\b", re.IGNORECASE)
_PACKS = re.compile(
    r"\b(peanut butter|almond butter|cashew butter|sunflower seed butter|sesame butter|tahini|spread|frostings?|icings?|"
    r"puddings?|hummus|paste|puree|fudge|cream cheese|ice creams?|sherbet|yogurts?|custard)\b",
    re.IGNORECASE,
)
_ROUND_BREAD = re.compile(
    r"\b(rolls?|buns?|muffins?|bagels?|doughnuts?|biscuits?|scones?|croissants?)\b", re.IGNORECASE
)
_HANDHELD = re.compile(
    r"\b(pizza|sandwich|sandwiches|hamburger|cheeseburger|burger|burrito|burritos|taco|tacos|enchilada|enchiladas|"
    r"quesadilla|hotdog|submarine|lasagna|pie|pot pie|egg rolls?|tamales?|pupusas?|wrap|biscuit|croissant|corndog|frankfurter|"
    r"fillet|steak|ribs?|patty|breast|drumstick|wing|thigh)\b",
    re.IGNORECASE,
)
_SMALL_FRUIT = re.compile(
    r"\b(blueberries|raspberries|strawberries|blackberries|cranberries|grapes|cherries|raisins|currants|gooseberries|"
    r"mulberries|elderberries|olives|dates|berries)\b",
    re.IGNORECASE,
)
_CUT = re.compile(
    r"\b(canned|frozen|dried|sliced|cut|stewed|sauce|dehydrated|chunks|salad|chopped|candied)\b", re.IGNORECASE
)
_WHOLE_VEGETABLE = re.compile(r"^(tomato|tomatoes|potato|potatoes|sweet potato|avocados?|corn)\b", re.IGNORECASE)
_MINCED = re.compile(r"\b(crumbles|ground|minced|shredded|flaked|canned)\b", re.IGNORECASE)
_WHOLE_EGG = re.compile(r"^egg, (whole|duck|goose|quail|turkey)", re.IGNORECASE)
_DISH = re.compile(
    r"\b(pizza|sandwich|sandwiches|hamburger|cheeseburger|burrito|taco|enchilada|quesadilla|lasagna|casserole|stew|chili|"
    r"with .* sauce|pot pie|egg rolls?|fried rice|macaroni and cheese|potato salad|coleslaw|chow mein|lo mein|tamales?|"
    r"ravioli|submarine|nachos|burger|dumplings?|chicken tenders|curry|paella|risotto|sushi)\b",
    re.IGNORECASE,
)
_DISH_GROUPS = ("meals, entrees", "mixed dish", "fast foods", "restaurant foods")
_SLAB_GROUPS = ("beef", "pork", "lamb", "poultry", "finfish", "sausages", "baked products", "meat")
_LIQUID_GROUPS = ("beverages",)


def usual_state(name: str) -> FoodState:
    """raw (dry goods and dough too), cooked or as_eaten, by the words of a food's name.

    "uncooked" and "dry" win over "cooked": "Rice, white, long-grain, parboiled, dry".
    """
    if _UNCOOKED.search(name):
        return "raw"
    return "cooked" if _COOKED.search(name) else "as_eaten"


def usual_form(name: str, group: str) -> FoodForm:
    """The form that a portion of the food most often has on a plate or in a glass."""
    of = group.lower()
    if _POWDER.search(name) and not _COOKED.search(name) and not of.startswith("baked"):
        return "heap"
    if of.startswith(_SLAB_GROUPS):
        return _meat_or_baked(name, of)
    if of.startswith("breakfast cereals"):
        return "slab" if re.search(r"\bbars?\b", name, re.IGNORECASE) else "heap"
    if _ICE_CREAM.search(name):
        return "slab" if re.search(r"\b(sandwich|bars?|cone)\b", name, re.IGNORECASE) else "heap"
    drink = _JUICE if of.startswith("vegetable") else _DRINK
    if of.startswith(_LIQUID_GROUPS) or (drink.search(_PACKED_IN.sub("", name)) and "salad" not in name.lower()):
        return "liquid"
    if of.startswith(("soup", "baby")):
        return "liquid" if _POURED.search(name) else "in_vessel"
    if of.startswith("fruit"):
        return "heap" if _SMALL_FRUIT.search(name) or _CUT.search(name) else "whole"
    if of.startswith("vegetable"):
        return "whole" if _WHOLE_VEGETABLE.search(name) and not _CUT.search(name) else "heap"
    if of.startswith("dairy"):
        return _dairy(name)
    if of.startswith(("fats", "sweets")):
        return "liquid" if _POURED.search(name) and not _FIRM.search(name) else "slab"
    return "slab" if _HANDHELD.search(name) or _FIRM.search(name) else "heap"


def is_mixed_dish(name: str, group: str) -> bool:
    """Whether the food is a dish of several foods, as eaten."""
    of = group.lower()
    if "meals, entrees" in of or "mixed dish" in of:
        return True
    return of.startswith(_DISH_GROUPS) and _DISH.search(name) is not None


def packs_without_air(name: str, group: str) -> bool:
    """Whether a plain cup or spoon of the food holds no air, so that its weight gives the density of the food itself."""
    return group.lower().startswith("fats") or _PACKS.search(name) is not None


def _meat_or_baked(name: str, of: str) -> FoodForm:
    if of.startswith("baked"):
        if name.lower().startswith("leavening"):
            return "heap"
        return "whole" if _ROUND_BREAD.search(name) else "slab"
    return "heap" if _MINCED.search(name) and "patty" not in name.lower() else "slab"


def _dairy(name: str) -> FoodForm:
    if _WHOLE_EGG.match(name):
        return "whole"
    if name.lower().startswith(("egg", "cheese")):
        return "heap" if re.search(r"\b(cottage|ricotta|scrambled|grated)\b", name, re.IGNORECASE) else "slab"
    return "liquid"
