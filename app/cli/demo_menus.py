"""Meals of the participants of the sample study: plates of the bundled photographs, and meals entered as text.

Foods are keys of the starter table; amounts are grams as eaten. The photographs are rendered: their volumes are known.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Person:
    """A participant. appetite: factor of the amounts below. keeps: probability of entering a meal and closing a day."""

    code: str
    profile: dict[str, object]
    appetite: float
    keeps: float


@dataclass(frozen=True, slots=True)
class Plate:
    """A bundled pair. points: the middle of each food in the left photograph, px, with the food's key."""

    folder: str  # below app/demo_data
    points: tuple[tuple[tuple[int, int], str], ...]
    left_over: tuple[tuple[tuple[int, int], str], ...] = ()  # in its after-meal pair


Dish = tuple[tuple[str, float], ...]

PEOPLE: tuple[Person, ...] = (
    Person(
        "P001", {"sex": "female", "birth_year": 1990, "height_cm": 168, "weight_kg": 62}, 1.0, 0.95
    ),
    Person(
        "P002",
        {
            "sex": "male",
            "birth_year": 1984,
            "height_cm": 181,
            "weight_kg": 83,
            "activity": "active",
        },
        1.35,
        0.9,
    ),
    Person(
        "P003", {"sex": "female", "birth_year": 1972, "height_cm": 161, "weight_kg": 70}, 0.9, 0.85
    ),
    Person(
        "P004", {"sex": "male", "birth_year": 1998, "height_cm": 176, "weight_kg": 71}, 1.2, 0.5
    ),
    Person(
        "P005", {"sex": "female", "birth_year": 2001, "height_cm": 170, "weight_kg": 58}, 1.05, 0.9
    ),
    Person(
        "P006", {"sex": "male", "birth_year": 1961, "height_cm": 174, "weight_kg": 79}, 1.1, 0.8
    ),
)

APPLE = Plate("", (((1092, 620), "apple"),))
RICE = Plate(
    "rice_banana_kiwifruit",
    (((296, 510), "rice-white-cooked"), ((544, 572), "banana"), ((483, 347), "kiwifruit")),
)
DOUGHNUT = Plate("doughnut_banana", (((756, 549), "doughnut"), ((647, 756), "banana")))
SALAD = Plate("salad_pear", (((401, 514), "salad-greens"), ((406, 326), "pear")))
ORANGE = Plate(
    "orange_kiwifruit",
    (((526, 473), "orange"), ((311, 429), "kiwifruit")),
    left_over=(((1013, 427), "orange"),),
)

BREAKFASTS: tuple[Dish, ...] = (
    (("oatmeal-cooked", 250), ("banana", 110), ("milk-whole", 120)),
    (("muesli", 65), ("yogurt", 150), ("coffee", 200)),
    (("bread-whole-wheat", 75), ("butter", 12), ("cheese-gouda", 40), ("coffee", 200)),
    (("egg-boiled", 100), ("bread-rye", 65), ("tomato", 80), ("tea", 250)),
)
LUNCHES: tuple[Dish, ...] = (
    (("pasta-cooked", 260), ("pasta-sauce", 130), ("cheese-parmesan", 12)),
    (("lentils-cooked", 220), ("rice-brown-cooked", 160), ("carrot-cooked", 90)),
    (("soup-minestrone", 350), ("bread-roll", 65), ("apple", 150)),
    (("chicken-breast-grilled", 140), ("rice-white-cooked", 190), ("broccoli-cooked", 120)),
    (("tuna-salad", 180), ("bread-french", 80), ("salad-greens", 60)),
)
DINNERS: tuple[Dish, ...] = (
    (("salmon", 150), ("potatoes-boiled", 230), ("green-beans-cooked", 130), ("butter", 8)),
    (("beef-stewed", 150), ("potato-mashed", 220), ("carrot-cooked", 100)),
    (("tofu-fried", 120), ("rice-white-cooked", 200), ("broccoli-cooked", 140)),
    (("egg-omelet", 170), ("bread-multigrain", 80), ("side-salad", 120)),
    (("spaghetti-meat-sauce", 400), ("lettuce-romaine", 70), ("olive-oil", 10)),
)
SNACKS: tuple[Dish, ...] = (
    (("apple", 160), ("walnuts", 25)),
    (("yogurt-fruit", 150),),
    (("cookie-oatmeal", 40), ("coffee", 200)),
    (("chocolate-bar-dark", 25), ("orange", 180)),
)
OCCASIONS: tuple[tuple[float, tuple[Dish, ...]], ...] = (  # local hour, possible dishes
    (7.5, BREAKFASTS),
    (12.5, LUNCHES),
    (15.75, SNACKS),
    (19.0, DINNERS),
)
