"""What foods of the tables in force are called, by their keys."""

from collections.abc import Collection

from app.db.session import Database
from app.foods.queries import foods_by_key


def food_names(database: Database, keys: Collection[str]) -> dict[str, str]:
    """Key -> name, of the keys that there are."""
    if not keys:
        return {}
    with database.read() as session:
        return {key: food.name for key, food in foods_by_key(session, keys).items()}
