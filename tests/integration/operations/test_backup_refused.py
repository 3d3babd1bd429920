"""A backup that is not what was written, or not for this place, is refused before anything is written."""

import gzip
import hashlib
import io
import json
import shutil
import tarfile
import uuid
from datetime import UTC, date, datetime

import pytest
import sqlalchemy as sa
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.errors import ConflictError, InvalidInputError
from app.db.schema_state import current_revision, head_revision
from app.db.session import Database
from app.foods.models import FoodRelease
from app.meals.job_models import Job
from app.meals.models import Meal, MealImage
from app.meals.record_models import Run
from app.nutrition.foods import load_starter_table
from app.operations.backup.backup_check import check_backup, empty_named
from app.operations.backup.backup_format import (
    CHUNK_BYTES,
    FORMAT,
    LACKING,
    MANIFEST,
    MAX_CHUNK_BYTES,
    MAX_LACKING_BYTES,
)
from app.people.access.secret_box import SecretBox, SecretKeyError
from app.people.models import Device, Participant, Study
from app.storage.opening import open_blob_store
from tests.integration.operations.deployments import SECRET, deployment, quiet, stored_under
from tests.integration.operations.forged_backups import Forgery

NOW = datetime(2026, 11, 20, 4, 30, 0, 123456, tzinfo=UTC)
BOX = SecretBox(SECRET)


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
        assert here.back_up(folder / "small.tar").end.damaged == 0
    return folder / "small.tar"


@pytest.fixture
def forgery(backup_file):
    return Forgery.of(backup_file)


def checked(content, box=BOX):
    with empty_named() as named:
        return check_backup(io.BytesIO(content), lambda _manifest: box, named, quiet)


def refusal(content, box=BOX):
    with pytest.raises(InvalidInputError) as refused:
        checked(content, box)
    return refused.value


def test_forgery_that_changes_nothing_is_taken(forgery):
    """Else the tests below would show nothing."""
    assert checked(forgery.to_bytes(BOX)).end.rows["meal"] == 1


SEEDED = settings(deadline=None, derandomize=True)


@given(share=st.floats(0, 1, exclude_max=True))
@settings(SEEDED, max_examples=60)
def test_backup_cut_off_anywhere_is_refused(backup_file, share):
    content = backup_file.read_bytes()
    assert refusal(content[: int(share * len(content))]).code == "backup_broken"


@given(share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@settings(SEEDED, max_examples=100)
def test_backup_with_one_bit_changed_anywhere_is_refused(backup_file, share, bit):
    content = bytearray(backup_file.read_bytes())
    content[int(share * len(content))] ^= 1 << bit
    # The schema's name decides which tables are read, before any checksum can be: one bit of it names another schema.
    assert refusal(bytes(content)).code in {"backup_broken", "backup_too_new", "backup_too_old"}


def test_bit_changed_in_a_header_or_a_byte_behind_the_end_is_noticed(backup_file):
    for offset in range(512):
        content = bytearray(backup_file.read_bytes())
        content[offset] ^= 32  # a capital letter for a small one, a space for a NUL: what parsers of numbers overlook
        assert refusal(bytes(content)).code == "backup_broken", offset
    assert refusal(backup_file.read_bytes() + b"\0").code == "backup_broken"


def test_member_that_is_left_out_or_comes_twice_is_noticed_whichever_it_is(backup_file):
    names = Forgery.of(backup_file).names()
    assert len(names) > 8
    for place, name in enumerate(names):
        for copies in (0, 2):
            forgery = Forgery.of(backup_file)
            forgery.members[place : place + 1] = [forgery.members[place]] * copies
            assert refusal(forgery.to_bytes(BOX)).code == "backup_broken", (name, copies)


def test_format_or_schema_that_is_not_known_is_told_as_newer_and_one_before_0_4_as_older(backup_file):
    for fields, code in (
        ({"format": FORMAT + 1}, "backup_too_new"),
        ({"revision": "20990101_unheard_of"}, "backup_too_new"),
        ({"revision": "20261124_baselile"}, "backup_too_new"),  # damaged, not older
        ({"revision": "20261123_spent_codes"}, "backup_too_old"),
    ):
        forgery = Forgery.of(backup_file)
        forgery.change_manifest(**fields)
        refused = refusal(forgery.to_bytes(BOX))
        assert refused.code == code
    assert "Only that version can restore it" in refused.message
    assert "broken" not in refused.message


def test_manifest_that_is_not_as_it_must_be_is_refused(backup_file):
    for fields in (
        {"format": "1"},
        {"created_at": "yesterday"},
        {"created_at": "2026-11-22T00:00:00"},
        {"revision": 7},
        {"tables": []},
        {"tables": {"meal": [["id", "uuid"]]}},
        {"tables": {"sqlite_master": [["sql", "text"]]}},
        {"more": 1},
    ):
        forgery = Forgery.of(backup_file)
        forgery.change_manifest(**fields)
        assert refusal(forgery.to_bytes(BOX)).code == "backup_broken", fields


def test_seal_of_another_key_is_refused_and_without_a_key_not_looked_at(forgery):
    content = forgery.to_bytes(SecretBox("x" * 40))
    assert "seal" in refusal(content).message
    assert checked(content, box=None).end.blobs == 2


def test_blob_under_a_name_that_leads_elsewhere_is_refused(backup_file):
    for name in ("../../etc/passwd", "/etc/passwd", "a/../../b", "a//b", ".incoming/x", "a\\..\\b"):
        forgery = Forgery.of(backup_file)
        forgery.add_blob(f"blobs/{name}/{hashlib.sha256(b'x').hexdigest()}", b"x")
        assert refusal(forgery.to_bytes(BOX)).code == "backup_broken", name
    forgery = Forgery.of(backup_file)
    forgery.change_value("meal_image", "blob_key", "../../../root/.ssh/authorized_keys/" + "0" * 64)
    assert refusal(forgery.to_bytes(BOX)).code == "backup_broken"


def test_blob_that_no_row_names_is_refused(forgery):
    forgery.add_blob(f"blobs/study/meal/left/{hashlib.sha256(b'x').hexdigest()}", b"x")
    assert "none of its rows" in refusal(forgery.to_bytes(BOX)).message


def test_blob_that_is_lacking_and_was_not_named_or_is_no_line_is_refused(forgery):
    forgery.end["damaged"] = 1
    lines = (b"{", b"3", b'["one"]', b'["a", 3]', b'["\\ud800", "missing"]', b'["study/of/nobody", "missing"]')
    for line in (*lines, b"[" * 100_000):
        forgery.change(LACKING, lambda _, line=line: line + b"\n")
        assert refusal(forgery.to_bytes(BOX)).code == "backup_broken", line[:50]


def test_lines_without_an_end_are_refused(forgery):
    for text in (b'["a", "missing"]', b"x" * (MAX_LACKING_BYTES + 1) + b"\n"):
        forgery.change(LACKING, lambda _, text=text: text)
        assert "line" in refusal(forgery.to_bytes(BOX)).message


def test_blob_that_is_told_as_lacking_is_taken_as_such_and_counted(forgery):
    place = forgery.place("blobs/")
    name, content = forgery.members.pop(place)
    forgery.change(LACKING, lambda _: json.dumps([name.removeprefix("blobs/"), "missing"]).encode() + b"\n")
    forgery.end["blobs"] -= 1
    forgery.end["blob_bytes"] -= len(content)
    assert "counts" in refusal(forgery.to_bytes(BOX)).message
    forgery.end["damaged"] = 1
    assert checked(forgery.to_bytes(BOX)).damaged_first == {name.removeprefix("blobs/"): "missing"}


def test_blob_with_other_bytes_is_refused_by_name(forgery):
    forgery.change("blobs/", lambda content: content[::-1])
    assert "has been changed" in refusal(forgery.to_bytes(BOX)).message


def test_member_that_is_no_file_or_claims_more_than_there_is_is_refused_without_reading_it():
    for kind_of_member in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE):
        info = tarfile.TarInfo(MANIFEST)
        info.type, info.linkname = kind_of_member, "/etc/passwd"
        assert refusal(info.tobuf(tarfile.PAX_FORMAT) + bytes(1024)).code == "backup_broken"
    huge = tarfile.TarInfo(MANIFEST)
    huge.size = 2**60
    assert refusal(huge.tobuf(tarfile.PAX_FORMAT) + bytes(2048)).code == "backup_broken"
    long = tarfile.TarInfo("x" * 100_000)
    assert "header" in refusal(long.tobuf(tarfile.PAX_FORMAT) + bytes(2048)).message


def test_chunk_that_unpacks_to_more_than_any_that_is_written_is_refused(forgery):
    forgery.change("tables/meal/", lambda _: gzip.compress(bytes(MAX_CHUNK_BYTES + CHUNK_BYTES), 9))
    assert refusal(forgery.to_bytes(BOX)).code == "backup_broken"


def test_value_of_another_type_is_refused(backup_file):
    for column, value in (
        ("id", "not an id"),
        ("id", None),
        ("captured_at", "2026-11-20T04:30:00"),
        ("local_date", "2026-02-30"),
        ("details", "{not json"),
        ("details", {"a": 1}),
        ("details", "[" * 200_000),
        ("utc_offset_minutes", 1.5),
        ("utc_offset_minutes", True),
        ("status", 7),
        ("version", 2**63),
    ):
        forgery = Forgery.of(backup_file)
        forgery.change_value("meal", column, value)
        refused = refusal(forgery.to_bytes(BOX))
        assert (refused.code, column in refused.message) == ("backup_broken", True), (column, str(value)[:50])


def test_row_with_a_value_too_many_is_refused(forgery):
    forgery.change_rows("meal", lambda rows: [[*rows[0], 1]])
    assert refusal(forgery.to_bytes(BOX)).code == "backup_broken"


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
    wrong_counts = Forgery.of(backup_file)
    wrong_counts.end["rows"]["meal"] = 2
    (tmp_path / "forged.tar").write_bytes(wrong_counts.to_bytes(BOX))
    with pytest.raises(InvalidInputError) as refused:
        machine.restore(tmp_path / "forged.tar")
    assert refused.value.code == "backup_broken"
    assert_untouched(machine)
    forgeries = [Forgery.of(backup_file) for _ in range(3)]
    forgeries[0].change_value("meal", "device_id", str(uuid.uuid4()))
    forgeries[1].change_value("meal", "status", "eaten")
    forgeries[2].change_rows("meal", lambda rows: [*rows, *rows])
    for forgery in forgeries:
        (tmp_path / "forged.tar").write_bytes(forgery.to_bytes(BOX))
        with pytest.raises(InvalidInputError) as refused:
            machine.restore(tmp_path / "forged.tar")
        assert refused.value.code == "backup_refused"
        assert "meal" in refused.value.message
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
    monkeypatch.setattr("app.operations.backup.refill.LEAVE_SECONDS", 0.5)
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
