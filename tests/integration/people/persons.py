"""A participant with everything that one can have, and where anything of theirs is left: rows, files, bytes."""

import hashlib
import pathlib
import uuid
from datetime import UTC, datetime, timedelta

import numpy as np
import sqlalchemy as sa

from app.db.base import Base
from app.diary.references.models import ReferenceDay
from app.exports.export_spec import ExportSpec, spec_as_json
from app.exports.models import Export
from app.exports.release_models import Release
from app.exports.releases.file_runner import FileRunner
from app.exports.releases.release_filters import ReleaseFilters
from app.foods.models import Food
from app.http.row_filter import RowFilter
from app.meals.stored.decision_models import ReviewDecision
from app.meals.stored.event_models import DayEvent, DiaryDay, MealEvent
from app.meals.stored.identification_models import IndexEntry, ItemIdentification
from app.meals.stored.job_models import Job, RemeasuredItem, RemeasuredPair, Remeasurement
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Item, ItemCandidate, ItemFood, ItemMeasure, Leftover, Run, RunArtefact
from app.outbox.models import Webhook, WebhookDelivery
from app.people.access.caller import sha256_hex
from app.people.access.secret_box import SecretBox
from app.people.models import CameraCalibration, Enrolment, Participant, PushSubscription, Staff, Study
from app.records.recompute_records import rebuild_records
from app.vision.looks.vcm import LENGTH, VCM_VERSION
from tests.integration.conftest import Phone, meal_metadata
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.filled_databases import fill_once
from tests.support.photographs import pair

OWNERS = {"participant", "device", "meal", "item", "run", "job", "meal_event"}
OWNED_BY = {f"{owner}_id" for owner in OWNERS} | {"event_id", "after_item_id", "parent_id"}
FILE_TABLES = {"export", "release", "release_file"}  # no column of theirs leads to a person, but their files do
OF_EVERYBODY = {"study", "staff", "food", "webhook", "recompute", "remeasurement"}
NOT_OF_THEM = {"audit_event", "webhook", *FILE_TABLES}  # whose ids and hashes may stay
SHA256_LENGTH = 64


class Person:
    """mark: stands in every free text of theirs, and in their code. with_files: an export of theirs and a release."""

    def __init__(self, state, enrol, mark, seed, *, with_files=False):
        self.state, self.mark = state, mark
        numbers = np.random.default_rng(seed).uniform(-1.0, 1.0, LENGTH)
        self.vector = numbers.astype("<f2").tobytes()  # what their food looked like
        before = all_keys(state.database)
        self.phone = enrol(mark)
        self.token_sha256 = sha256_hex(self.phone.headers["Authorization"].removeprefix("Bearer "))
        self.metadata = meal_metadata(
            hints=[{"point": [30, 20], "food": "apple"}],
            app_version=f"app {mark}",
            captured_at="2026-11-20T12:30:00+08:00",
        )
        self.photos = pair(seed)
        assert self.phone.post(self.photos, self.metadata).status_code == 202
        estimates.save(state, self.metadata["id"], found_item(hint=0))
        self._fill(state)
        rebuild_records(state.database, write=True)
        with state.database.write() as session:
            meal = session.get_one(Meal, self.meal_id)
            meal.status, self.local_date = "needs_review", meal.local_date
        if with_files:
            self._ask_for_files(state)
            assert make_files(state) == ["done", "done"]
        self.rows = {table: sorted(keys - before[table]) for table, keys in all_keys(state.database).items()}

    @property
    def path(self):
        return f"/v1/meals/{self.metadata['id']}"

    def _fill(self, state):
        now, mark = datetime.now(UTC), self.mark
        with state.database.write() as session:
            person = session.scalars(sa.select(Participant).where(Participant.code == mark)).one()
            person.profile = {"sex": "female", "note": mark}
            person.visit, person.excluded = f"seen by {mark}", f"{mark} moved away"
            person.favourites = [{"name": f"breakfast of {mark}", "items": []}]
            meal = session.scalars(sa.select(Meal).where(Meal.participant_id == person.id)).one()
            self.participant_id, self.meal_id, self.device_id = person.id, meal.id, meal.device_id
            self.aliases = {person.alias, meal.alias}
            meal.after_details = {"app_version": mark, "location": None}
            run = session.scalars(sa.select(Run).where(Run.meal_id == meal.id)).one()
            item = session.scalars(sa.select(Item).where(Item.meal_id == meal.id)).one()
            apple = session.scalars(sa.select(Food).limit(1)).one()
            content = f"picture of {mark}".encode()
            sha256 = hashlib.sha256(content).hexdigest()
            key = f"{meal.study_id}/{meal.id}/runs/{run.id}/topview.jpg/{sha256}"
            state.blobs.put_bytes(key, content)
            run.result_key = f"{meal.study_id}/{meal.id}/runs/{run.id}/result.json/{'0' * 64}"
            state.blobs.put_bytes(run.result_key, mark.encode())
            shape = {"rings": [], "relative_sd": {}, "flags": []}
            owned = {"id": uuid.uuid4, "created_at": lambda: now, "meal_id": lambda: meal.id}
            owned |= {"participant_id": lambda: person.id, "device_id": lambda: meal.device_id}

            def add(model, /, **fields):
                """A row that is whose it must be, as far as the table has columns for that."""
                defaults = {name: make() for name, make in owned.items() if name in model.__table__.columns}
                row = model(**defaults | fields)
                session.add(row)
                session.flush()
                return row

            picture = {"media_type": "image/jpeg", "bytes": len(content), "sha256": sha256, "blob_key": key}
            add(RunArtefact, run_id=run.id, name="topview.jpg", **picture)
            said = {"comment": {"text": f"said {mark}"}, "confirm": {"status": "confirmed"}}
            event, _ = (
                add(
                    MealEvent,
                    sequence=sequence,
                    item_id=item.id,
                    kind=kind,
                    layer="participant",
                    old={},
                    new=new,
                    request_sha256=hashlib.sha256(f"{kind} of {mark}".encode()).hexdigest(),
                )
                for sequence, (kind, new) in enumerate(said.items(), 10)
            )
            job = add(Job, purpose="remeasure", event_id=event.id, state="done", enqueued_at=now, finished_at=now)
            remeasured = add(
                Run,
                id=job.id,
                purpose="remeasure",
                method="paper",
                pipeline_version="test",
                marker="plain:9x7:11",
                parameters={},
                stages={},
                seconds=1.0,
                food_releases=[],
                result_key=f"{meal.study_id}/{meal.id}/runs/{job.id}/result.json/{'1' * 64}",
            )
            after = add(Item, origin="declared", parent_id=item.id, event_id=event.id, position=9, **shape)
            again = add(
                Remeasurement,
                study_id=meal.study_id,
                author="admin",
                selection="all meals",
                state="done",
                pipeline_version="test",
                ended_at=now,
            )
            hook = session.scalars(sa.select(Webhook)).first() or add(
                Webhook,
                study_id=meal.study_id,
                url="https://example.org/",
                events=["meal.confirmed"],
                secret_sealed="x",
                author="admin",
            )
            by_index = {"probability": 0.5, "source": "index", "run_id": remeasured.id}
            add(ItemCandidate, item_id=after.id, position=0, food_id=apple.id, **by_index)
            looked = {"item_id": item.id, "run_id": run.id, "vcm_version": VCM_VERSION}
            add(ItemIdentification, **looked, vector=self.vector, index_version="test", none_probability=0.1)
            add(
                IndexEntry,
                **looked,
                study_id=meal.study_id,
                food_key="apple",
                volume_ml=item.volume_ml,
                captured_at=meal.captured_at,
                day_minute=12 * 60 + 30,
            )
            add(ItemFood, item_id=after.id, version=1, food_id=apple.id, edible_share=1.0, event_id=event.id)
            add(ItemMeasure, item_id=item.id, event_id=event.id, run_id=remeasured.id, **shape)
            kept = {"pair": "meal", "position": 0, "state": "kept", "reason": "other_items", "ended_at": now}
            add(RemeasuredPair, remeasurement_id=again.id, **kept)
            add(RemeasuredItem, remeasurement_id=again.id, item_id=item.id, is_changed=False)
            add(
                ReviewDecision,
                study_id=meal.study_id,
                item_id=item.id,
                staff_id=session.scalars(sa.select(Staff.id)).first(),
                is_final=False,
                food_key="apple",
                mass_g=80.0,
                decided_at=now,
            )
            add(
                Leftover,
                after_item_id=after.id,
                version=1,
                item_id=item.id,
                leftover_class="food_left",
                event_id=event.id,
                flags=[],
            )
            self._fill_beside_meals(add, meal, hook)

    def _fill_beside_meals(self, add, meal, hook):
        """What is not about their meals: days, calibration, reminders, enrolment; and webhooks that told of them."""
        now, mark = datetime.now(UTC), self.mark
        day = {"status": "closed", "ate_nothing": False, "changed_at": now, "change_seq": 0}
        add(DiaryDay, local_date=meal.local_date, study_id=meal.study_id, **day)
        add(ReferenceDay, local_date=meal.local_date, amounts={"energy_kcal": 1840.0})
        add(DayEvent, local_date=meal.local_date, kind="closed", layer="participant", author=mark)
        camera = {"marker": "plain:9x7:11", "camera": {}, "rms_px": 0.2, "photographs": 9}
        add(CameraCalibration, model=mark, author=mark, **camera)
        add(
            PushSubscription,
            endpoint=f"https://push.example.org/{mark}",
            public_key=f"key of {mark}",
            auth=f"secret of {mark}",
            times=["12:30"],
            after_meal=True,
            time_zone="Europe/Berlin",
            quiet_from_minutes=0,
            quiet_until_minutes=0,
        )
        add(Enrolment, code_sha256=sha256_hex(f"code of {mark}"), expires_at=now + timedelta(days=1))
        delivery = {"webhook_id": hook.id, "event": "meal.confirmed", "state": "delivered"}
        of_meal = {"data": {"participant": mark, "meal_id": str(meal.client_id)}}
        add(WebhookDelivery, **delivery, participant_id=None, payload=of_meal)
        add(WebhookDelivery, **delivery, meal_id=None, payload={"data": {"participant": mark}})

    def _ask_for_files(self, state):
        """An export that names them, and a release of the whole study."""
        spec = ExportSpec("meals", output="csv", filters=RowFilter(study_code="pilot", participant_code=self.mark))
        with state.database.write() as session:
            asked = {
                "id": uuid.uuid4(),
                "study_id": session.scalars(sa.select(Study.id).where(Study.code == "pilot")).one(),
                "staff_id": session.scalars(sa.select(Staff.id)).first(),
                "state": "queued",
                "requested_at": datetime.now(UTC),
            }
            told = spec_as_json(spec)
            session.add(Export(**asked, spec=told, spec_sha256=hashlib.sha256(repr(told).encode()).hexdigest()))
            filters = ReleaseFilters().as_json()
            session.add(
                Release(**asked, name=f"of-{self.mark.lower()[:4]}", note="", filters=filters, former_checksums=[])
            )

    def needles(self):
        """What must be nowhere once they are erased: their mark, ids, hashes, keys and pieces of their photographs."""
        found = {self.mark, self.token_sha256}
        shared = set()
        with self.state.database.read() as session:
            for model in (Study, Staff, Webhook, Remeasurement):
                shared.update(map(str, session.scalars(sa.select(model.id))))
            for mapper in Base.registry.mappers:
                table = mapper.local_table
                for key in self.rows.get(table.name, ()):
                    row = session.execute(sa.select(table).where(key_condition(table, key))).one()
                    for column, value in zip(table.columns, row, strict=True):
                        if column.name == "alias" or str(value) in shared or table.name in NOT_OF_THEM:
                            continue
                        if isinstance(value, uuid.UUID):
                            found.add(str(value))
                        elif isinstance(value, str) and (len(value) == SHA256_LENGTH or "/runs/" in value):
                            found.add(value)
        texts = sorted(found)
        assert len(texts) > 20
        needles = [text.lower().encode() for text in texts]
        needles += [uuid.UUID(text).hex.encode() for text in texts if len(text) == 36 and text.count("-") == 4]
        needles += [content[len(content) // 2 :][:64].lower() for content in self.photos.values()]
        needles.append(self.vector[:64].lower())
        return needles


def kept_person(state, enrol, client, admin, mark, seed):
    """Return Person(state, enrol, mark, seed), made once per worker and copied (SQLite) with its blobs and tokens."""
    folder = state.settings.data_dir

    def fill(_database):
        person = Person(state, enrol, mark, seed)
        files = {path.relative_to(folder): path.read_bytes() for path in folder.glob("blobs/**/*") if path.is_file()}
        known = {name: value for name, value in vars(person).items() if name not in ("state", "phone")}
        return known, (person.phone.headers, admin), files

    known, (of_phone, of_admin), files = fill_once(state.database, fill, key=("person", mark, seed))
    admin.update(of_admin)
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    person = Person.__new__(Person)
    vars(person).update(known, state=state, phone=Phone(client, of_phone))
    return person


def make_files(state):
    """Everything that waits for a worker's side process is made: what became of each."""
    found = []
    while ended := FileRunner(
        state.database, state.blobs, state.settings, state.part(SecretBox), uuid.uuid4()
    ).run_one():
        found.append(ended.outcome)
    return found


def all_keys(database):
    """Table -> primary keys of its rows, as text."""
    with database.read() as session:
        return {
            table.name: {tuple(map(str, row)) for row in session.execute(sa.select(*table.primary_key.columns))}
            for table in Base.metadata.tables.values()
        }


def key_condition(table, key):
    columns = table.primary_key.columns
    return sa.and_(*(_as_text(column, value) for column, value in zip(columns, key, strict=True)))


def _as_text(column, value):
    python_type = column.type.python_type
    if python_type is uuid.UUID:
        return column == uuid.UUID(value)
    if python_type is int:
        return column == int(value)
    if python_type.__name__ == "date":
        return column == python_type.fromisoformat(value)
    return column == value


def personal_tables():
    """Tables that can hold something of a person: by foreign keys, and by columns that name one without."""
    found = {"participant"}
    while True:
        more = {
            table.name
            for table in Base.metadata.tables.values()
            if table.name not in found
            and (
                any(key.column.table.name in found - OF_EVERYBODY for key in table.foreign_keys)
                or any(column.name in OWNED_BY for column in table.columns)
            )
        }
        if not more:
            return found
        found |= more


def database_bytes(database):
    """All that the database holds, in lower case: SQLite's files; every row of every table of PostgreSQL as text."""
    if database.is_sqlite:
        path = pathlib.Path(sa.make_url(database.url).database)
        files = [file for file in (path, path.with_name(path.name + "-wal")) if file.exists()]
        return b"".join(file.read_bytes() for file in files).lower()
    texts = []
    with database.read() as session:
        tables = session.execute(
            sa.text("SELECT schemaname, tablename FROM pg_tables WHERE schemaname IN ('public', 'dbos')")
        ).all()
        for schema, table in tables:
            if table in ("food", "food_nutrient", "food_word", "food_posting", "food_word_trigram", "food_portion"):
                continue
            rows = session.scalars(sa.text(f'SELECT t::text FROM "{schema}"."{table}" t'))
            texts += [f"{schema}.{table} {row}" for row in rows]
    return "\n".join(texts).lower().encode()


def tables_with_alias(database, aliases):
    """Tables of which a row holds one of these ids, in any column."""
    found = set()
    with database.read() as session:
        for table in Base.metadata.tables.values():
            if table.name.startswith("food"):
                continue
            for row in session.execute(sa.select(table)):
                if any(str(alias) in str(value) for alias in aliases for value in row):
                    found.add(table.name)
    return found
