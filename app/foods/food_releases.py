"""List the releases of food tables, and choose which release of a name is in force: one row switches it."""

from dataclasses import dataclass
from datetime import UTC, datetime

from app.core.errors import NotFoundError
from app.db.session import Database
from app.foods import queries as foods
from app.foods.models import FoodActivation, FoodRelease


@dataclass(frozen=True, slots=True)
class ListedRelease:
    """A release, and whether it is in force."""

    release: FoodRelease
    is_in_force: bool


def list_releases(database: Database) -> list[ListedRelease]:
    """Return the releases in force in lookup order, then the others, the newest first."""
    with database.read() as session:
        in_force = foods.releases_in_force(session)
        inactive = [release for release in foods.all_releases(session) if release not in in_force]
    return [ListedRelease(release, release in in_force) for release in (*in_force, *inactive)]


def use_release(database: Database, name: str, version: str | None, author: str) -> None:
    """Put the newest import of this version in force, or none of this name. Raises NotFoundError."""
    with database.write() as session:
        same_name = [release for release in foods.all_releases(session) if release.name == name]
        chosen = [
            release
            for release in same_name
            if release.version == version and release.completed_at is not None
        ]
        if not same_name or (version is not None and not chosen):
            raise NotFoundError(
                f"There is no complete release {name} {version or ''}".rstrip()
                + ": see `tada foods releases`.",
                code="food_release_not_found",
            )
        release_id = chosen[0].id if version is not None else None
        session.add(
            FoodActivation(
                name=name, release_id=release_id, author=author, activated_at=datetime.now(UTC)
            )
        )
