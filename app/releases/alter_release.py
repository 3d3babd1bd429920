"""Removing erased data from a release: its files are rewritten from the old files alone.

Rows of an erased meal or participant are removed; the day of an erased meal is computed from its remaining meals
(release_days.py); foods without items are removed too. An anonymised participant gets a new code and new meal ids,
without profile, places, photographs and their hashes. Pending removals are stored as keyed digests, so that no erased
code or id stays in the database.
"""

import uuid
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from app.exports.release_models import ReleaseChange
from app.http.tables.columns import Column, Row
from app.http.tables.participant_columns import PROFILE
from app.people.access.secret_box import SecretBox
from app.releases.freeze_release import OF_FOODS, TABLES
from app.releases.release_days import NamedRow, day_without
from app.releases.release_files import Contents, Manifest, ReleaseFiles

PERSONAL_COLUMNS = frozenset(  # emptied for an anonymised participant
    {
        "longitude",
        "latitude",
        *(column.name for column in PROFILE),
        *(f"{side}_{kind}_sha256" for side in ("left", "right") for kind in ("received", "stored")),
    }
)
GONE = None
Key = tuple[str, str | None]  # participant, meal
FetchFile = Callable[[str], Path]  # file name in the release -> local file


def meal_digest(box: SecretBox, participant_code: str, meal_id: uuid.UUID | str) -> str:
    """Return the digest by which a meal's rows are recognised in a release."""
    return box.digest("release.meal", f"{participant_code}\n{meal_id}")


def participant_digest(box: SecretBox, participant_code: str) -> str:
    """Return the digest by which a participant's rows are recognised in a release."""
    return box.digest("release.participant", participant_code)


@dataclass(slots=True)
class Verdicts:
    """The new participant and meal of each row, or GONE, computed once per participant and meal.

    Changes are indexed by digest, so that each name is digested once, however many changes there are. After a rename
    the later changes are searched for the new name.
    """

    box: SecretBox
    changes: Sequence[ReleaseChange]
    verdicts: dict[Key, Key | None] = field(default_factory=dict)
    participant_digests: dict[str, str] = field(default_factory=dict)  # by code
    places_by_digest: dict[str, list[int]] = field(init=False)  # ascending places in changes

    def __post_init__(self) -> None:
        """Index the changes by digest."""
        self.places_by_digest = {}
        for place, change in enumerate(self.changes):
            self.places_by_digest.setdefault(change.digest, []).append(place)

    def __call__(self, participant: str, meal_id: str | None = None) -> Key | None:
        """Return GONE, or the row's new participant and meal."""
        key = (participant, meal_id)
        if key not in self.verdicts:
            self.verdicts[key] = self._judge(participant, meal_id)
        return self.verdicts[key]

    def _judge(self, participant: str, meal_id: str | None) -> Key | None:
        """Apply the changes in their order: an anonymised participant may be erased later, by the new code."""
        after = -1
        while (place := self._next_change(participant, meal_id, after)) is not None:
            change, after = self.changes[place], place
            if change.new_code is None or change.new_ids is None:
                return GONE
            participant = change.new_code
            meal_id = str(uuid.uuid5(change.new_ids, meal_id)) if meal_id is not None else None
        return participant, meal_id

    def _next_change(self, participant: str, meal_id: str | None, after: int) -> int | None:
        """Return the place of the first change of this participant or meal after place `after`."""
        if participant not in self.participant_digests:
            self.participant_digests[participant] = participant_digest(self.box, participant)
        digests = [self.participant_digests[participant]]
        if meal_id is not None:
            digests.append(meal_digest(self.box, participant, meal_id))
        places = (place for digest in digests for place in self.places_by_digest.get(digest, ()) if place > after)
        return min(places, default=None)


@dataclass(slots=True)
class _ChangedDay:
    """A day with an erased meal: rows of its meals, and of the items of the remaining ones."""

    left: list[NamedRow] = field(default_factory=list)
    gone: list[NamedRow] = field(default_factory=list)
    items: list[NamedRow] = field(default_factory=list)


class ReleaseAlteration:
    """The removal of erased data from one release. manifest: its release.json; fetch_file: fetches its files."""

    def __init__(self, manifest: Manifest, fetch_file: FetchFile, verdicts: Verdicts) -> None:
        self._manifest, self._fetch_file, self._judge = manifest, fetch_file, verdicts
        self._days: dict[Key, _ChangedDay] = {}

    def is_affected(self) -> bool:
        """Whether the release has erased data; collects the days that change.

        Only codes and meals are read at first, since the release is not served meanwhile.
        """
        tables = [name for name in ("meals", "days", "participants") if name in self._manifest.tables]
        if not any(self._judge(*key) != key for table in tables for key in self._keys(table)):
            return False
        for row in self._rows("meals"):
            is_gone = self._judge(row["participant"], row["meal_id"]) is GONE
            if is_gone and self._judge(row["participant"]) is not GONE:
                self._days.setdefault((row["participant"], row["local_date"]), _ChangedDay()).gone.append(row)
        return True

    def write(self, files: ReleaseFiles) -> Contents:
        """Write all tables and the dictionary without the erased data. Call `is_affected` first."""
        if self._days:
            for row in self._rows("meals"):
                self._collect(row, "left")
            for row in self._rows("items"):
                self._collect(row, "items")
        contents = Contents()
        for name in TABLES:
            if name in self._manifest.tables:  # older releases have no participants
                columns = self._manifest.tables[name]
                rows = self._remaining_rows(name, columns)
                files.add_table(name, columns, contents.count_rows(name, columns, rows))
        for table in OF_FOODS:
            columns = self._manifest.tables[table]
            files.add_table(table, columns, self._remaining_foods(columns, table, contents))
        files.add_dictionary()
        return contents

    def _remaining_rows(self, name: str, columns: Sequence[Column]) -> Iterator[Row]:
        has_meal = name not in ("days", "participants")
        names = [column.name for column in columns]
        for row in self._rows(name):
            verdict = self._judge(row["participant"], row["meal_id"] if has_meal else None)
            if verdict is GONE:
                continue
            is_renamed = verdict[0] != row["participant"]
            if is_renamed and name == "photographs":
                continue
            kept: NamedRow | None = row
            if name == "days" and (day := self._days.get((row["participant"], row["local_date"]))) is not None:
                kept = day_without(
                    row,
                    day.left,
                    day.gone,
                    day.items,
                    expects_after_pair=self._manifest.protocol.expects_after_pair,
                )
            if kept is None:
                continue
            if is_renamed:
                kept = _renamed(kept, *verdict)
            yield tuple(kept[column] for column in names)

    def _remaining_foods(self, columns: Sequence[Column], name: str, contents: Contents) -> Iterator[Row]:
        """Yield the rows of foods that still have items; a study's own densities hold for any version of a food."""
        keys = {key for key, _, _ in contents.foods}
        for row in self._rows(name):
            food = (row["food_key"], row["food_version"], row["food_table"])
            if food in contents.foods or (row["food_table"] is None and row["food_key"] in keys):
                yield tuple(row[column.name] for column in columns)

    def _collect(self, row: NamedRow, kind: Literal["left", "items"]) -> None:
        day = self._days.get((row["participant"], row["local_date"]))
        if day is not None and self._judge(row["participant"], row["meal_id"]) is not GONE:
            (day.left if kind == "left" else day.items).append(row)

    def _keys(self, table: str) -> Iterator[Key]:
        """Yield the participant and meal of each row; of days and participants only the participant."""
        for row in self._rows(table, only=("participant", "meal_id")):
            yield row["participant"], row.get("meal_id")

    def _rows(self, name: str, only: Collection[str] | None = None) -> Iterator[NamedRow]:
        """Yield a table's rows. only: names of columns to read; None: all."""
        from app.http.tables.table_files import read_rows  # noqa: PLC0415  # pyarrow

        columns = [column for column in self._manifest.tables[name] if only is None or column.name in only]
        names = [column.name for column in columns]
        for row in read_rows(columns, self._fetch_file(f"{name}.parquet")):
            yield dict(zip(names, row, strict=True))


def _renamed(row: NamedRow, participant: str, meal_id: str | None) -> NamedRow:
    changed = {name: None if name in PERSONAL_COLUMNS else value for name, value in row.items()}
    changed["participant"] = participant
    if meal_id is not None:
        changed["meal_id"] = meal_id
    return changed
