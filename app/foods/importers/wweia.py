"""What We Eat in America's food categories: which are mixed dishes, and the group by which the form is inferred.

The four digits are ordered: 1000s milk and dairy, 2000s protein foods, 3000s mixed dishes, 4000s grains, 5000s snacks
and sweets, 6000s fruits and vegetables, 7000s beverages, 8000s fats, condiments and sugars, 9000s infant foods.
"""

from bisect import bisect_right

# First code -> the group, by its name in usual_form.py.
_GROUPS: tuple[tuple[int, str], ...] = (
    (0, "Meals, Entrees, and Side Dishes"),
    (1000, "Beverages"),
    (1600, "Dairy and Egg Products"),
    (2000, "Meat"),
    (2500, "Dairy and Egg Products"),
    (2600, "Sausages and Luncheon Meats"),
    (2800, "Legumes and Legume Products"),
    (2804, "Nut and Seed Products"),
    (2806, "Legumes and Legume Products"),
    (3000, "Meals, Entrees, and Side Dishes"),
    (3800, "Soups, Sauces, and Gravies"),
    (4000, "Cereal Grains and Pasta"),
    (4200, "Baked Products"),
    (4600, "Breakfast Cereals"),
    (5000, "Snacks"),
    (5200, "Baked Products"),
    (5700, "Sweets"),
    (6000, "Fruits and Fruit Juices"),
    (6400, "Vegetables and Vegetable Products"),
    (7000, "Beverages"),
    (8000, "Fats and Oils"),
    (8400, "Soups, Sauces, and Gravies"),
    (8408, "Vegetables and Vegetable Products"),
    (8410, "Soups, Sauces, and Gravies"),
    (8800, "Sweets"),
    (9000, "Baby Foods"),
    (9200, "Beverages"),
    (9800, "Snacks"),
    (9999, "Meals, Entrees, and Side Dishes"),
)
_STARTS = [start for start, _ in _GROUPS]


def group_of_category(code: int) -> str:
    """Return the SR group by which the form of a food of this category is inferred."""
    return _GROUPS[bisect_right(_STARTS, code) - 1][1]


def is_mixed_category(code: int) -> bool:
    """Return whether the category's foods are dishes of several foods (including sandwiches, pizza and soups)."""
    return 3000 <= code <= 3999
