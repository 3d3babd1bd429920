"""Teach a study a food: by items of its meals, and by photographs that the food fills.

An item teaches by being named, as in review: its entry in the index follows from its record. A
photograph is a draft until it is put in force; only its vectors are kept. What decodes photographs
or compares vectors runs in a limited child.
"""

import uuid
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.candidates import queries as index_entries
from app.candidates.queries import AnyRow
from app.children.api_children import ApiChildren, Whose
from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.foods.models import Food
from app.http.state import ApiState
from app.http.upload import ReceivedFile
from app.meals.stored.identification_models import ItemIdentification, TaughtPhotograph
from app.meals.stored.run_answer import VcmAnswer
from app.people.access.audit import note
from app.people.access.caller import StaffCaller
from app.people.models import Study
from app.records.review.meal_events import MealEvents
from app.records.review.queries import QueueFilter
from app.records.review.review_items import ReviewItem, read_review_page
from app.records.review.schemas import SetFoodIn

MOST_AT_ONCE = 12  # photographs of an upload
MOST_ITEMS = 24  # that are offered
MOST_PHOTOGRAPHS = 100  # of a food: more examples are people's own confirmations
SECONDS = 30.0  # of processor time


@dataclass(frozen=True, slots=True)
class FoodTeaching:
    """A food as a study is taught it. caller: who teaches it."""

    state: ApiState
    caller: StaffCaller
    study: Study
    food: Food

    def photographs(self) -> Sequence[TaughtPhotograph]:
        """Return the photographs, drafts too, oldest first."""
        with self.state.database.read() as session:
            return self._photographs(session)

    def unnamed_items(self) -> list[ReviewItem]:
        """Return items of the review queue that have no food."""
        queue = QueueFilter(self.study.id, status="needs_review")
        page = read_review_page(self.state.database, queue, cursor=None, limit=MOST_ITEMS)
        return [item for item in page.rows if item.row.food is None]

    def add_photographs(self, files: Iterable[ReceivedFile]) -> int:
        """Keep the vectors of photographs as drafts; return how many are new.

        Raises InvalidInputError with read_photo's code if one cannot be used, ConflictError
        (`photographs_too_many`), and what ApiChildren.run raises; then none is kept.
        """
        described = {
            file.sha256: self._describe(file, place) for place, file in enumerate(files, start=1)
        }
        with self.state.database.write() as session:
            earlier = {row.sha256 for row in self._photographs(session)}
            new = described.keys() - earlier
            if len(earlier) + len(new) > MOST_PHOTOGRAPHS:
                raise ConflictError(
                    f"At most {MOST_PHOTOGRAPHS} photographs teach a food: take some back.",
                    code="photographs_too_many",
                )
            session.add_all(
                TaughtPhotograph(
                    id=uuid.uuid4(),
                    study_id=self.study.id,
                    food_key=self.food.key,
                    sha256=sha256,
                    vcm_version=described[sha256][0].version,
                    vector=b"".join(view.vector for view in described[sha256]),
                    created_at=datetime.now(UTC),
                )
                for sha256 in new
            )
            self._note(session, "food.draft", photographs=len(new))
        return len(new)

    def rank_examples(self, items: Iterable[ReviewItem]) -> Mapping[str, object]:
        """Name the food's photographs and these items by all others, the index and the study.

        Of the study's entries the first two thousand count. Returns what rank_task does.
        Raises as ApiChildren.run.
        """
        key = self.food.key
        with self.state.database.read() as session:
            entries = index_entries.changed_entries(
                session, self.study.id, index_entries.BEFORE_ALL
            )
            learned = [_piece(row.item_id, row.food_key, row) for row in next(entries, ())]
            pieces = [_piece(row.id, key, row) for row in self._photographs(session)]
            for item in items:
                item_id, identified = item.row.record.item_id, item.candidates.identified
                if identified is not None:
                    primary_key = (item_id, identified.run_id, identified.vcm_version)
                    row = session.get(ItemIdentification, primary_key)
                    if row is not None:  # not erased meanwhile
                        pieces.append(_piece(item_id, key, row))
        if not pieces:
            return {}
        index = self.state.settings.food_index
        request = {"index": index and str(index), "pieces": pieces, "learned": learned}
        children = self.state.part(ApiChildren)
        return children.run(
            "rank", request, seconds=SECONDS, whose=Whose(self.study.id, self.caller.staff_id)
        )

    def put_in_force(self, items: Sequence[ReviewItem]) -> int:
        """Put the drafts in force, and name these items.

        Returns how many teach anew. Raises as MealEvents.append.
        """
        for item in items:
            record, meal = item.row.record, item.row.meal
            event = SetFoodIn(
                id=uuid.uuid4(), kind="set_food", item=record.item_id, food=self.food.key
            )
            self.state.part(MealEvents).append(
                self.caller,
                meal.client_id,
                event,
                expected=None,
                participant_code=item.row.participant_code,
            )
        with self.state.database.write() as session:
            drafts = [row for row in self._photographs(session) if row.in_force_at is None]
            for draft in drafts:
                draft.in_force_at = datetime.now(UTC)
            self._note(session, "food.teach", photographs=len(drafts), items=len(items))
        return len(items) + len(drafts)

    def take_back(self, photograph_id: uuid.UUID) -> None:
        """Delete a photograph's vectors. Raises NotFoundError."""
        with self.state.database.write() as session:
            photograph = session.get(TaughtPhotograph, photograph_id)
            if photograph not in self._photographs(session):
                raise NotFoundError(
                    "No such photograph teaches this food.", code="photograph_not_found"
                )
            session.delete(photograph)
            self._note(session, "food.unteach", photographs=1)

    def _photographs(self, session: Session) -> Sequence[TaughtPhotograph]:
        return index_entries.taught_photographs(session, self.study.id, self.food.key)

    def _describe(self, file: ReceivedFile, place: int) -> list[VcmAnswer]:
        """Describe a photograph of an upload, by its views. place: counted from 1."""
        children, settings = self.state.part(ApiChildren), self.state.settings
        answer = children.run(
            "describe",
            {"photo": str(file.path), "max_pixels": settings.max_photo_pixels, "regions": None},
            seconds=SECONDS,
            whose=Whose(self.study.id, self.caller.staff_id),
            photograph_sha256=file.sha256,
            is_costly=True,
        )
        failure = answer["failure"]
        if failure is not None:
            raise InvalidInputError(
                f"Photograph {place}: {failure['message']}", code=failure["code"]
            )
        return [VcmAnswer.model_validate(view) for view in answer["vcms"]]

    def _note(self, session: Session, action: str, **counts: int) -> None:
        note(
            session,
            self.caller,
            action,
            study_id=self.study.id,
            subject=self.food.key,
            **counts,
        )


def _piece(
    name: uuid.UUID, food_key: str, row: AnyRow | TaughtPhotograph | ItemIdentification
) -> dict[str, str]:
    """A piece as rank_task takes it."""
    return {
        "name": str(name),
        "food_key": food_key,
        "vcm_version": row.vcm_version,
        "vector": b64encode(row.vector).decode(),
    }
