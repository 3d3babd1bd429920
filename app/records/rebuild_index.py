"""Vectors of the current version for items that have none, and the study's index in line with them.

From the sealed photographs, which only a child of the limited pool decodes. One meal at a time:
described outside any transaction, written in a short one after a look whether meal and photograph
are still there. What is done stays done, so that a run that broke off is gone on with by the next.
"""

import tempfile
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy.orm import Session

from app.candidates import queries as vectors
from app.candidates.queries import DESCRIBED_SLOT, SeenRegion
from app.children.child_pool import ChildPool, ChildRequest, ChildStartError
from app.core.errors import UnavailableError
from app.core.settings import Settings
from app.db.session import Database
from app.meals.stored import queries as meals
from app.meals.stored.identification_models import ItemIdentification
from app.meals.stored.meal_parts import parts_of
from app.meals.stored.models import MealImage
from app.meals.stored.receive_photo import sha256_of_file
from app.meals.stored.run_answer import VcmAnswer
from app.people.studies import load_study
from app.records.project_records import Projector, write_records
from app.storage.blob_store import BlobMissingError, BlobStore
from app.vision.looks.vcm import VCM_VERSION

log = structlog.get_logger()

BATCH = 200  # meals a reading
SECONDS = 60.0  # of one photograph and its regions


@dataclass(frozen=True, slots=True)
class Described:
    """Numbers of regions.

    kept: had a vector; described: have one now, or would get one; gone: their photograph is erased;
        unreadable: it is damaged, or nothing of the region is in it
    """

    kept: int = 0
    described: int = 0
    gone: int = 0
    unreadable: int = 0


def check_index(database: Database, *, study_code: str | None) -> Described:
    """What rebuild_index would do; changes nothing and opens no photograph.

    Raises NotFoundError for no such study.
    """

    def count(meal_id: uuid.UUID) -> Described:
        with database.read() as session:
            regions = len(vectors.regions_to_describe(session, meal_id, VCM_VERSION))
            is_there = vectors.photograph_of(session, meal_id) is not None
        return Described(described=regions) if is_there else Described(gone=regions)

    return _of_all(database, study_code, count)


def rebuild_index(
    database: Database,
    blobs: BlobStore,
    children: ChildPool,
    settings: Settings,
    *,
    study_code: str | None,
) -> Described:
    """Describe what has no vector of the current version.

    Raises NotFoundError for no such study, UnavailableError where no child process starts.
    """
    describe = partial(_describe, database, blobs, children, settings)
    return _of_all(database, study_code, describe)


class DescribeIdly:
    """The same as a worker's chore: while no estimate runs, one meal after the other, once through all of them."""

    def __init__(
        self, database: Database, blobs: BlobStore, children: ChildPool, settings: Settings
    ) -> None:
        self._database = database
        self._children = children
        self._describe = partial(_describe, database, blobs, children, settings)
        self._after: uuid.UUID | None = None
        self._is_done = False

    def run(self) -> None:
        """Describe the next meal, if there is one and time for it. Raises UnavailableError as rebuild_index."""
        if self._is_done or not self._children.is_idle:
            return
        with self._database.read() as session:
            batch = vectors.meals_to_describe(
                session, VCM_VERSION, after=self._after, limit=1, study_id=None
            )
        if batch:
            self._describe(batch[0])
            self._after = batch[0]
        self._is_done = not batch


def _describe(
    database: Database,
    blobs: BlobStore,
    children: ChildPool,
    settings: Settings,
    meal_id: uuid.UUID,
) -> Described:
    """Describe the regions of a meal that have no vector of the current version."""
    with database.read() as session:
        regions = vectors.regions_to_describe(session, meal_id, VCM_VERSION)
        image = vectors.photograph_of(session, meal_id)
    if not regions or image is None:
        return Described(gone=len(regions))
    with tempfile.TemporaryDirectory(prefix="tada-", dir=blobs.staging_folder()) as name:
        path = Path(name) / "photo"
        if not _fetch(blobs, image, path):
            return Described(unreadable=len(regions))
        made = _vectors(children, settings, path, regions)
    return _write(database, meal_id, regions, made)


def _of_all(
    database: Database, study_code: str | None, of_meal: Callable[[uuid.UUID], Described]
) -> Described:
    """Return the sums over a study's meals, or all."""
    with database.read() as session:
        study_id = _study_id(session, study_code)
        counted = Counter(kept=vectors.described(session, VCM_VERSION, study_id=study_id))
    for meal_id in _meals(database, study_code):
        counted.update(asdict(of_meal(meal_id)))
    return Described(**counted)


def _fetch(blobs: BlobStore, image: MealImage, path: Path) -> bool:
    """Whether the photograph is there as it was sealed."""
    try:
        blobs.fetch(image.blob_key, path)
    except (BlobMissingError, OSError):
        log.exception("photo_missing", blob_key=image.blob_key)
        return False
    if sha256_of_file(path) != image.stored_sha256:
        log.error("photo_damaged", blob_key=image.blob_key)
        return False
    return True


def _vectors(
    children: ChildPool, settings: Settings, photo: Path, regions: Sequence[SeenRegion]
) -> Sequence[bytes | None]:
    """Each region's vector; None: the photograph cannot be decoded, or nothing of the region is in it."""
    request = ChildRequest(
        task="describe",
        arguments={
            "photo": str(photo),
            "max_pixels": settings.max_photo_pixels,
            "regions": [_asked(region) for region in regions],
        },
    )
    try:
        ended = children.run(request, lambda _: None, seconds=SECONDS)
    except ChildStartError as error:
        raise UnavailableError(
            "No child process starts that could read photographs: see the log."
        ) from error
    if ended.is_passing:
        raise UnavailableError("The machine is too busy to read photographs: try again later.")
    if ended.outcome != "ok" or ended.result["failure"] is not None:
        log.error(
            "regions_not_described", outcome=ended.outcome, message=ended.message.partition(":")[0]
        )
        return [None] * len(regions)
    return [
        VcmAnswer.model_validate(vcm).vector if vcm is not None else None
        for vcm in ended.result["vcms"]
    ]


def _write(
    database: Database,
    meal_id: uuid.UUID,
    regions: Sequence[SeenRegion],
    made: Sequence[bytes | None],
) -> Described:
    with database.write() as session:
        meal = meals.lock_meal(session, meal_id)
        if meal is None or vectors.photograph_of(session, meal_id) is None:  # erased meanwhile
            return Described(gone=len(regions))
        bare = {
            (region.item_id, region.run_id)
            for region in vectors.regions_to_describe(session, meal_id, VCM_VERSION)
        }
        now = datetime.now(UTC)
        new = [
            ItemIdentification(
                item_id=region.item_id,
                run_id=region.run_id,
                vcm_version=VCM_VERSION,
                vector=vector,
                index_version=None,
                none_probability=None,
                created_at=now,
            )
            for region, vector in zip(regions, made, strict=True)
            if vector is not None
            and (region.item_id, region.run_id) in bare  # another command may have been quicker
        ]
        session.add_all(new)
        session.flush()
        write_records(session, Projector(session).project(parts_of(session, [meal])[0]))
    unreadable = sum(vector is None for vector in made)
    return Described(
        kept=len(made) - unreadable - len(new), described=len(new), unreadable=unreadable
    )


def _meals(database: Database, study_code: str | None) -> Iterator[uuid.UUID]:
    """Meals with a region that has no vector, by id, read a batch at a time: no transaction is open meanwhile."""
    after: uuid.UUID | None = None
    while True:
        with database.read() as session:
            study_id = _study_id(session, study_code)
            batch = vectors.meals_to_describe(
                session, VCM_VERSION, after=after, limit=BATCH, study_id=study_id
            )
        yield from batch
        if len(batch) < BATCH:
            return
        after = batch[-1]


def _study_id(session: Session, code: str | None) -> uuid.UUID | None:
    return None if code is None else load_study(session, code).id


def _asked(region: SeenRegion) -> dict[str, Any]:
    """The region as describe_task takes it."""
    colour = region.colour.get(DESCRIBED_SLOT) if region.colour is not None else None
    return {"rings": region.rings, "colour": colour, "marker": region.marker}
