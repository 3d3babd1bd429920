"""A backup that is not what was written, or not for this place, is refused before anything is written."""

import gzip
import hashlib
import io
import json
import pathlib
import shutil
import tarfile
import uuid
from datetime import UTC, date, datetime

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import sqlalchemy as sa
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.errors import ConflictError, InvalidInputError, TadaError
from app.core.settings import Settings
from app.db.schema_state import current_revision, head_revision
from app.db.session import Database
from app.foods.models import FoodRelease
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import Run
from app.nutrition.foods import load_starter_table
from app.operations.backup.archive import FORMAT, LACKING, MANIFEST, SEAL, ArchiveWriter
from app.operations.backup.restore import check_backup
from app.people.access.secret_box import SecretBox, SecretKeyError
from app.people.models import Device, Participant, Study
from app.storage.opening import open_blob_store
from tests.integration.operations.deployments import SECRET, deployment, quiet, stored_under

NOW = datetime(2026, 11, 20, 4, 30, 0, 123456, tzinfo=UTC)


def add_meal(here):
    """One meal with a photograph and a run, in a database without foods."""
    ids = {name: uuid.uuid4() for name in ("study", "participant", "device", "meal", "job", "image")}
    photo = stored_under(here.blobs, f"{ids['study']}/{ids['meal']}/left", b"a photograph")
    result = stored_under(here.blobs, f"{ids['study']}/{ids['meal']}/runs/{ids['job']}/result.json", b"{}")
    starter = load_starter_table()  # its release, without its foods: a restored deployment need not load them then
    release = {"name": starter.name, "version": starter.version, "released_on": starter.released_on}
    with here.database.write() as session:
        for row in (
            FoodRelease(source="starter", checksum=starter.checksum, imported_at=NOW, completed_at=NOW, **release),
            Study(id=ids["study"], code="pilot", name="Pilot", created_at=NOW, change_seq=7),
            Participant(id=ids["participant"], study_id=ids["study"], code="P1", created_at=NOW),
            Device(id=ids["device"], participant_id=ids["participant"], name="phone", enrolled_at=NOW),
            Meal(
                id=ids["meal"], client_id=uuid.uuid4(), study_id=ids["study"], participant_id=ids["participant"],
                device_id=ids["device"], captured_at=NOW, utc_offset_minutes=0, time_zone="UTC",
                local_date=date(2026, 11, 20), details={"hints": [1.5, None]}, status="estimated", received_at=NOW,
            ),
            MealImage(
                id=ids["image"], meal_id=ids["meal"], slot="left", media_type="image/jpeg", width_px=4, height_px=3,
                bytes=12, received_sha256="0" * 64, stored_sha256=photo[-64:], blob_key=photo, received_at=NOW,
            ),
            Job(id=ids["job"], meal_id=ids["meal"], state="done", enqueued_at=NOW, finished_at=NOW),
            Run(
                id=ids["job"], meal_id=ids["meal"], method="paper", pipeline_version="test", marker="plain:9x7:11",
                parameters={}, stages={}, seconds=0.1, food_releases=[], result_key=result, created_at=NOW,
            ),
        ):  # fmt: skip
            session.add(row)
            session.flush()
    return ids


@pytest.fixture(scope="module")
def backup_file(tmp_path_factory, sqlite_migrated):
    """A small backup: one meal, no foods."""
    folder = tmp_path_factory.mktemp("small")
    shutil.copyfile(sqlite_migrated, folder / "tada.sqlite3")
    with deployment(folder, f"sqlite:///{folder / 'tada.sqlite3'}") as here:
        add_meal(here)
        assert here.back_up(folder / "small.tar").damaged_blobs == 0
    return folder / "small.tar"


def refusal(content, settings):
    with pytest.raises(TadaError) as refused:
        check_backup(io.BytesIO(content), settings, quiet)
    return refused.value


@pytest.fixture(scope="module")
def known_key(tmp_path_factory):
    """Settings of a machine that has the backup's key."""
    return Settings(data_dir=tmp_path_factory.mktemp("known"), secret_key=SECRET)


def members_of(path):
    with tarfile.open(path) as tar:
        return [(member.name, tar.extractfile(member).read()) for member in tar if member.name != SEAL]


def sealed(members, key=SECRET):
    """A backup of other members, sealed as if nothing were."""
    file = io.BytesIO()
    writer = ArchiveWriter(file, mtime=0)
    for name, content in members:
        writer.add_bytes(name, content)
    writer.seal(SecretBox(key))
    return file.getvalue()


def changed(members, prefix, change):
    """The first member whose name begins so gets other content; change(None) is another member."""
    place = next(number for number, (name, _) in enumerate(members) if name.startswith(prefix))
    name, content = members[place]
    return [*members[:place], (name, change(content)), *members[place + 1 :]]


def with_manifest(members, **fields):
    return changed(members, MANIFEST, lambda text: json.dumps(json.loads(text) | fields).encode())


def with_rows(members, table, change):
    """change: from an Arrow table to another."""

    def rewritten(content):
        file = io.BytesIO()
        pq.write_table(change(pq.read_table(io.BytesIO(content))), file)
        return file.getvalue()

    return changed(members, f"tables/{table}/", rewritten)


def with_value(members, column, value):
    """Another value in the only row of meal."""

    def change(rows):
        place = rows.schema.get_field_index(column)
        return rows.set_column(place, column, pa.array([value], rows.schema.field(column).type))

    return with_rows(members, "meal", change)


SEEDED = settings(deadline=None, derandomize=True)


@given(share=st.floats(0, 1, exclude_max=True))
@settings(SEEDED, max_examples=60)
def test_backup_cut_off_anywhere_is_refused(backup_file, known_key, share):
    content = backup_file.read_bytes()
    assert refusal(content[: int(share * len(content))], known_key).code == "backup_broken"


@given(share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@settings(SEEDED, max_examples=100)
def test_backup_with_one_bit_changed_anywhere_is_refused(backup_file, known_key, share, bit):
    content = bytearray(backup_file.read_bytes())
    content[int(share * len(content))] ^= 1 << bit
    codes = {"backup_broken", "backup_too_new", "backup_too_old"}  # one bit makes another format or schema
    assert refusal(bytes(content), known_key).code in codes


def test_bit_changed_in_headers_of_the_first_and_the_last_member_or_a_byte_behind_is_noticed(backup_file, known_key):
    whole = backup_file.read_bytes()
    for offset in (*range(512), *range(len(whole) - 2048, len(whole) - 1536)):
        content = bytearray(whole)
        content[offset] ^= 32  # a capital letter for a small one, a space for a NUL: what parsers of numbers overlook
        assert refusal(bytes(content), known_key).code == "backup_broken", offset
    assert refusal(whole + b"\0", known_key).code == "backup_broken"


def test_member_that_is_left_out_or_comes_twice_is_noticed_whichever_it_is(backup_file, known_key):
    """By somebody who does not have the key: with it, anything can be written."""
    members = members_of(backup_file)
    assert len(members) > 8
    for place in range(1, len(members)):
        for copies in (0, 2):
            forged = [*members[:place], *[members[place]] * copies, *members[place + 1 :]]
            tail = backup_file.read_bytes()[-2048:]
            assert refusal(sealed(forged)[:-2048] + tail, known_key).code == "backup_broken"
            assert refusal(sealed(forged, "x" * 40), known_key).code == "secret_key_wrong"


def test_format_or_schema_that_is_not_known_is_told_as_newer(backup_file, known_key):
    for fields in ({"format": FORMAT + 1}, {"revision": "20990101_unheard_of"}):
        forged = with_manifest(members_of(backup_file), **fields)
        assert refusal(sealed(forged), known_key).code == "backup_too_new"


def test_backup_of_0_4_is_refused_with_what_to_do(known_key):
    """Made by that version, of the meal below and with the same key."""
    content = gzip.decompress(pathlib.Path(__file__).with_name("backup-0.4.0.tar.gz").read_bytes())
    refused = refusal(content, known_key)
    assert refused.code == "backup_too_old"
    assert "version 0.4.0" in refused.message
    assert "restore it with that version, upgrade the restored deployment, then back it up anew" in refused.message


def test_manifest_that_is_not_as_it_must_be_is_refused(backup_file, known_key):
    for fields in (
        {"format": None},
        {"created_at": "yesterday"},
        {"created_at": "2026-11-22T00:00:00"},
        {"revision": 7},
        {"more": 1},
    ):
        forged = with_manifest(members_of(backup_file), **fields)
        assert refusal(sealed(forged), known_key).code == "backup_broken", fields


def test_sealed_member_that_no_backup_has_is_refused(backup_file, known_key):
    """As a lost key could let one through: no path leads out of the store, no column is of another type."""
    members, digest = members_of(backup_file), hashlib.sha256(b"x").hexdigest()
    names = ("../../etc/passwd", "/etc/passwd", "a/../../b", "a//b", ".incoming/x", "a\\..\\b")
    forgeries = [[*members, (f"blobs/{name}/{digest}", b"x")] for name in names]
    forgeries += [
        [*members, ("blobs/study/meal/left", b"x")],
        [*members, ("README", b"x")],
        [*members, ("tables/sqlite_master/000001.parquet", b"x")],
        changed(members, "tables/meal/", lambda content: content[::-1]),
        with_rows(members, "meal", lambda rows: rows.append_column("more", pa.array([1]))),
        with_rows(members, "meal", lambda rows: rows.drop_columns(["status"])),
        with_rows(members, "meal", lambda rows: rows.set_column(0, "id", pa.array(["not an id"]))),
        *(changed(members, LACKING, lambda _, line=line: line) for line in (b"{", b"3", b'["one"]')),
    ]
    for number, forged in enumerate(forgeries):
        assert refusal(sealed(forged), known_key).code == "backup_broken", number


def test_member_that_is_no_file_or_claims_more_than_there_is_is_refused_without_reading_it(known_key):
    for kind_of_member in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE):
        info = tarfile.TarInfo(MANIFEST)
        info.type, info.linkname = kind_of_member, "/etc/passwd"
        assert refusal(info.tobuf(tarfile.PAX_FORMAT) + bytes(1024), known_key).code == "backup_broken"
    huge = tarfile.TarInfo(MANIFEST)
    huge.size = 2**60
    assert refusal(huge.tobuf(tarfile.PAX_FORMAT) + bytes(2048), known_key).code == "backup_broken"


@pytest.fixture
def machine(tmp_path, database_url):
    """An empty machine: a database without tables."""
    with deployment(tmp_path / "machine", database_url) as machine:
        yield machine


def assert_untouched(machine):
    assert machine.stored() == {}
    assert current_revision(machine.database) is None


@pytest.mark.both_stores
def test_ledger_of_erasures_that_cannot_be_read_is_told_before_anything_is_written(backup_file, database_url, tmp_path):
    (tmp_path / "file").touch()
    ledger = f"file://{tmp_path / 'file' / 'ledger'}"
    with deployment(tmp_path / "machine", database_url, erasure_url=ledger) as machine:
        with pytest.raises(OSError, match="Not a directory"):
            machine.restore(backup_file)
        assert_untouched(machine)
    with deployment(tmp_path / "machine", database_url) as machine:
        ledger = open_blob_store(machine.settings.resolved_erasure_url, machine.settings)
        ledger.put_bytes("meal/" + "a" * 64, b"{}")
        with pytest.raises(InvalidInputError) as refused:
            machine.restore(backup_file)
        assert refused.value.code == "ledger_broken"
        assert_untouched(machine)


def test_refused_backup_leaves_nothing_nor_do_rows_that_the_database_does_not_take(machine, backup_file, tmp_path):
    members, forged = members_of(backup_file), tmp_path / "forged.tar"
    forged.write_bytes(sealed(members[:-1])[:-1])
    with pytest.raises(InvalidInputError) as refused:
        machine.restore(forged)
    assert refused.value.code == "backup_broken"
    assert_untouched(machine)
    for other in (
        with_value(members, "device_id", uuid.uuid4().bytes),
        with_value(members, "status", "eaten"),
        with_rows(members, "meal", lambda rows: pa.concat_tables([rows, rows])),
        changed(members, "blobs/", lambda content: content[::-1]),
    ):
        forged.write_bytes(sealed(other))
        with pytest.raises(InvalidInputError) as refused:
            machine.restore(forged)
        assert refused.value.code == ("backup_refused" if "rows" in refused.value.message else "backup_broken")
        with machine.database.read() as session:
            assert session.scalar(sa.select(sa.func.count()).select_from(Study)) == 0
    machine.restore(backup_file)  # the true one goes in after them
    with machine.database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Meal)) == 1
    assert current_revision(machine.database) == head_revision()


def test_backup_of_another_key_or_none_is_refused_unless_the_key_is_lost(backup_file, database_url, tmp_path):
    folder = tmp_path / "machine"
    with deployment(folder, database_url, secret_key=None) as machine:
        with pytest.raises(SecretKeyError, match=r"secret\.key"):
            machine.restore(backup_file)
        assert not (folder / "secret.key").exists()  # it draws none
    with deployment(folder, database_url, secret_key="y" * 40) as machine:
        with pytest.raises(SecretKeyError):
            machine.restore(backup_file)
        assert_untouched(machine)
        machine.restore(backup_file, other_key=True)
        assert len(machine.rows()["meal"]) == 1


@pytest.mark.both_stores
def test_restore_over_data_is_refused_before_the_backup_is_read(backup_file, database, tmp_path, monkeypatch):
    """Reading it may take an hour."""
    monkeypatch.setattr("app.operations.backup.restore.check_backup", None)
    with deployment(tmp_path / "machine", database.url) as machine:
        add_meal(machine)
        before = machine.rows(), machine.stored()
        with pytest.raises(ConflictError) as refused:
            machine.restore(backup_file)
        assert refused.value.code == "deployment_not_empty"
        assert (machine.rows(), machine.stored()) == before


@pytest.mark.both_stores
def test_restore_beside_blobs_of_others_is_refused(backup_file, machine):
    key = stored_under(machine.blobs, "study/meal/left", b"somebody's")
    with pytest.raises(ConflictError) as refused:
        machine.restore(backup_file)
    assert refused.value.code == "deployment_not_empty"
    assert machine.stored() == {key: b"somebody's"}


def test_restore_while_a_process_has_the_database_open_is_refused(backup_file, database, tmp_path, monkeypatch):
    monkeypatch.setattr("app.operations.backup.target.LEAVE_SECONDS", 0.5)
    with deployment(tmp_path / "machine", database.url) as machine:
        other = Database(database.url)
        with other.read() as session:
            session.execute(sa.select(Study)).all()
        try:
            with pytest.raises(ConflictError) as refused:
                machine.restore(backup_file)
        finally:
            other.dispose()
        assert refused.value.code == "deployment_in_use"
        assert machine.stored() == {}
        machine.restore(backup_file)
        assert len(machine.rows()["meal"]) == 1
