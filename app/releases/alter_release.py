"""A release without what was erased: its files are written anew from the old ones, and from nothing else.

Rows of an erased meal or person go; the day that a meal was on is worked out anew from what is left of it
(release_days.py); foods that nothing is of any more go too. A person whose data stay without them (anonymise) stands
under the code and ids drawn for it, without places, photographs and their hashes. What is to go is known by keyed
digests, so that nobody's code or id waits in the database.
"""

import uuid
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from app.exports.release_models import ReleaseChange
from app.http.tables.columns import Column, Row
from app.people.access.secret_box import SecretBox
from app.releases.freeze_release import OF_FOODS
from app.releases.release_days import NamedRow, day_without
from app.releases.release_files import Contents, ReleaseFiles, columns_told

OF_PERSON = frozenset(  # columns that are emptied where a person's data stay without them
    {
        "longitude",
        "latitude",
        *(f"{side}_{kind}_sha256" for side in ("left", "right") for kind in ("received", "stored")),
    }
)
GONE = None
Key = tuple[str, str | None]  # participant, meal
Fetched = Callable[[str], Path]  # a file of the release by name, as a local file


def meal_digest(box: SecretBox, participant_code: str, meal_id: uuid.UUID | str) -> str:
    """By which a meal is found in a release: by what its rows say."""
    return box.digest("release.meal", f"{participant_code}\n{meal_id}")


def participant_digest(box: SecretBox, participant_code: str) -> str:
    """By which a participant is found in a release."""
    return box.digest("release.participant", participant_code)


@dataclass(slots=True)
class Verdicts:
    """What becomes of rows, by participant and meal: the names that they keep or get, or GONE. Each found out once.

    However many changes there are, a name is digested once: changes are found by what they are of. Only who gets
    another name is looked for again, by that name, among the changes after it.
    """

    box: SecretBox
    changes: Sequence[ReleaseChange]
    known: dict[Key, Key | None] = field(default_factory=dict)
    persons: dict[str, str] = field(default_factory=dict)  # code -> digest
    of_digest: dict[str, list[int]] = field(init=False)  # places in changes, in their order

    def __post_init__(self) -> None:
        """By digest."""
        self.of_digest = {}
        for place, change in enumerate(self.changes):
            self.of_digest.setdefault(change.digest, []).append(place)

    def __call__(self, participant: str, meal_id: str | None = None) -> Key | None:
        """GONE, or the row's participant and meal from now on."""
        key = (participant, meal_id)
        if key not in self.known:
            self.known[key] = self._judge(participant, meal_id)
        return self.known[key]

    def _judge(self, participant: str, meal_id: str | None) -> Key | None:
        """The changes one after the other: who was made nameless may be erased later, by the new name."""
        after = -1
        while (place := self._first(participant, meal_id, after)) is not None:
            change, after = self.changes[place], place
            if change.new_code is None or change.new_ids is None:
                return GONE
            participant = change.new_code
            meal_id = str(uuid.uuid5(change.new_ids, meal_id)) if meal_id is not None else None
        return participant, meal_id

    def _first(self, participant: str, meal_id: str | None, after: int) -> int | None:
        """The place of the first change behind that place which is of this person or meal."""
        if participant not in self.persons:
            self.persons[participant] = participant_digest(self.box, participant)
        digests = [self.persons[participant]]
        if meal_id is not None:
            digests.append(meal_digest(self.box, participant, meal_id))
        places = (place for digest in digests for place in self.of_digest.get(digest, ()) if place > after)
        return min(places, default=None)


@dataclass(slots=True)
class _Touched:
    """A day that a meal was taken from: rows of its meals, and of the items of those that are left."""

    left: list[NamedRow] = field(default_factory=list)
    gone: list[NamedRow] = field(default_factory=list)
    items: list[NamedRow] = field(default_factory=list)


class ReleaseAlteration:
    """One release's changes. manifest: its release.json; fetched: its files."""

    def __init__(self, manifest: Mapping[str, Any], fetched: Fetched, verdicts: Verdicts) -> None:
        self._manifest, self._fetched, self._judge = manifest, fetched, verdicts
        self._days: dict[Key, _Touched] = {}

    def is_met(self) -> bool:
        """Whether the release has anything of what is to go. Notes which days are touched.

        Names alone are read first: a release without it is not served for as long as that takes.
        """
        tables = [name for name in ("meals", "days") if name in self._manifest["tables"]]
        if not any(self._judge(*names) != names for table in tables for names in self._names(table)):
            return False
        for row in self._rows("meals"):
            is_gone = self._judge(row["participant"], row["meal_id"]) is GONE
            if is_gone and self._judge(row["participant"]) is not GONE:
                self._days.setdefault((row["participant"], row["local_date"]), _Touched()).gone.append(row)
        return True

    def write(self, files: ReleaseFiles) -> Contents:
        """All tables and the dictionary without what is to go. Call `is_met` first."""
        if self._days:
            for row in self._rows("meals"):
                self._note(row, "left")
            for row in self._rows("items"):
                self._note(row, "items")
        contents = Contents()
        for name in ("items", "meals", "days", "photographs"):
            if name in self._manifest["tables"]:
                columns = columns_told(self._manifest, name)
                rows = self._changed(name, columns)
                files.add_table(name, columns, contents.of_table(name, columns, rows))
        for name in OF_FOODS:
            columns = columns_told(self._manifest, name)
            files.add_table(name, columns, self._of_foods(columns, name, contents))
        files.add_dictionary()
        return contents

    def _changed(self, name: str, columns: Sequence[Column]) -> Iterator[Row]:
        has_meal = name != "days"
        names = [column.name for column in columns]
        for row in self._rows(name):
            verdict = self._judge(row["participant"], row["meal_id"] if has_meal else None)
            if verdict is GONE:
                continue
            is_renamed = verdict[0] != row["participant"]
            if is_renamed and name == "photographs":
                continue
            kept: NamedRow | None = row
            if not has_meal and (touched := self._days.get((row["participant"], row["local_date"]))) is not None:
                kept = day_without(
                    row,
                    touched.left,
                    touched.gone,
                    touched.items,
                    expects_after_pair=self._manifest["protocol"]["expects_after_pair"],
                )
            if kept is None:
                continue
            if is_renamed:
                kept = _renamed(kept, *verdict)
            yield tuple(kept[column] for column in names)

    def _of_foods(self, columns: Sequence[Column], name: str, contents: Contents) -> Iterator[Row]:
        """Rows of foods that items are still of; a study's own densities are of a food in any version."""
        keys = {key for key, _, _ in contents.foods}
        for row in self._rows(name):
            food = (row["food_key"], row["food_version"], row["food_table"])
            if food in contents.foods or (row["food_table"] is None and row["food_key"] in keys):
                yield tuple(row[column.name] for column in columns)

    def _note(self, row: NamedRow, what: str) -> None:
        touched = self._days.get((row["participant"], row["local_date"]))
        if touched is not None and self._judge(row["participant"], row["meal_id"]) is not GONE:
            (touched.left if what == "left" else touched.items).append(row)

    def _names(self, table: str) -> Iterator[Key]:
        """Participant and meal of each row; of a table of days the participant."""
        for row in self._rows(table, only=("participant", "meal_id")):
            yield row["participant"], row.get("meal_id")

    def _rows(self, name: str, only: Collection[str] | None = None) -> Iterator[NamedRow]:
        """A table's rows. only: columns that are wanted; None: all."""
        from app.http.tables.table_files import read_rows  # noqa: PLC0415  # pyarrow

        every = columns_told(self._manifest, name)
        columns = [column for column in every if only is None or column.name in only]  # in the file's order
        names = [column.name for column in columns]
        for row in read_rows(columns, self._fetched(f"{name}.parquet")):
            yield dict(zip(names, row, strict=True))


def _renamed(row: NamedRow, participant: str, meal_id: str | None) -> NamedRow:
    changed = {name: None if name in OF_PERSON else value for name, value in row.items()}
    changed["participant"] = participant
    if meal_id is not None:
        changed["meal_id"] = meal_id
    return changed
