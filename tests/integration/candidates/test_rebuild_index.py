"""`tada index rebuild`: new vectors from the sealed photographs, entries in line, and what cannot be described told."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import sqlalchemy as sa
from typer.testing import CliRunner

from app.children.child_pool import ChildPool, ChildResult, ChildStartError
from app.cli.main import cli
from app.core.errors import NotFoundError, UnavailableError
from app.jobs.supervisor import settings_environment
from app.meals.estimate.estimate_json import colour_to_json
from app.meals.stored.identification_models import IndexEntry, ItemIdentification
from app.meals.stored.models import MealImage
from app.meals.stored.record_models import EffectiveRecord, Item, ItemMeasure
from app.operations.doctor.doctor import examine
from app.people.models import Study
from app.privacy.retention import erase_old_pictures
from app.records.rebuild_index import Described, DescribeIdly, check_index, rebuild_index
from app.vision.looks.vcm import VCM_VERSION, describe_rings
from app.vision.model import ColourCorrection
from app.vision.photograph.photo import read_photo
from app.worker import TASKS
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import found_item, vcm
from tests.support.photographs import pair

pytestmark = pytest.mark.slow

RING = [[100.0, 80.0], [300.0, 90.0], [280.0, 300.0], [110.0, 280.0]]
DRAWN = [[50.0, 50.0], [150.0, 50.0], [150.0, 200.0]]
OLD = vcm(0.5, 1.0, version="old")
REDDER = ColourCorrection(np.diag([1.2, 1.0, 0.9]), "white")
COLOUR = {"left": colour_to_json(REDDER), "right": colour_to_json(ColourCorrection(np.eye(3), "none"))}


@pytest.fixture
def children(settings):
    pool = ChildPool(settings, TASKS, children=1)
    yield pool
    pool.close()


@pytest.fixture
def rebuild(state, settings, children):
    def rebuild(study_code=None, by=children):
        return rebuild_index(state.database, state.blobs, by, settings, study_code=study_code)

    return rebuild


@pytest.fixture
def meal_of(state, enrol, client):
    """A meal of an apple whose region was described long ago, confirmed: meal_of(seed, study)."""

    def meal_of(seed=1, study="pilot", item=None, **answer):
        phone, photos = enrol(study=study), pair(seed)
        body = meal_metadata(hints=[{"point": [200, 200], "food": "apple"}])
        assert phone.post(photos, body).status_code == 202
        item = item if item is not None else found_item(polygon=RING, vcm=OLD)
        estimates.save(state, body["id"], item, **{"colour": COLOUR} | answer)
        speaker = Speaker(client, phone.headers, body["id"])
        speaker.say("confirm", item=speaker.items()[0]["id"])
        return speaker, photos["left"]

    return meal_of


def rows(state, table):
    with state.database.read() as session:
        return list(session.scalars(sa.select(table)))


def new_vectors(state):
    return [row for row in rows(state, ItemIdentification) if row.vcm_version == VCM_VERSION]


def expected(photo, rings, colour=REDDER):
    """What describe gives in this process, as it is kept."""
    pixels = read_photo(photo, max_pixels=3_000_000).pixels_bgr
    return describe_rings(pixels, [np.array(ring) for ring in rings], colour).astype("<f2").tobytes()


def test_item_of_an_older_version_gets_a_new_vector_its_entry_follows_and_a_second_run_does_nothing(
    state, meal_of, rebuild
):
    _, photo = meal_of()
    (before,) = rows(state, IndexEntry)
    (record,) = rows(state, EffectiveRecord)
    assert before.vcm_version == "old"
    assert check_index(state.database, study_code=None) == Described(described=1)
    assert new_vectors(state) == []
    assert rebuild() == Described(described=1)
    (new,) = new_vectors(state)
    assert new.vector == expected(photo, [RING])
    assert (new.run_id, new.index_version, new.none_probability) == (before.run_id, None, None)
    (entry,) = rows(state, IndexEntry)
    assert (entry.item_id, entry.run_id, entry.vcm_version) == (before.item_id, before.run_id, VCM_VERSION)
    assert rows(state, EffectiveRecord)[0].change_seq > record.change_seq  # by which indexes find the entry
    assert len(rows(state, ItemIdentification)) == 2  # what the run saw then stays
    assert check_index(state.database, study_code=None) == rebuild() == Described(kept=1)


def test_item_of_a_run_that_described_nothing_and_kept_no_colour_is_described_as_its_pixels_are(
    state, meal_of, rebuild
):
    _, photo = meal_of(item=found_item(polygon=RING), colour=None)
    assert rows(state, IndexEntry) == []
    assert rebuild() == Described(described=1)  # the noise of the photograph has no board in it
    assert new_vectors(state)[0].vector == expected(photo, [RING], None)
    assert rows(state, IndexEntry)[0].food_key == "apple"


@pytest.mark.both_stores
def test_candidates_of_the_run_stay_when_its_region_is_described_again(state, meal_of, rebuild):
    speaker, _ = meal_of()
    before = speaker.meal()["items"]
    rebuild()
    assert speaker.meal()["items"] == before


def test_region_that_was_drawn_and_measured_again_is_described_under_its_own_run(state, meal_of, rebuild):
    speaker, photo = meal_of()
    run_id = measured_again(state, speaker, found_item(polygon=DRAWN, hint=0))
    assert rebuild() == Described(described=2)
    assert {row.run_id: row.vector for row in new_vectors(state)}[run_id] == expected(photo, [DRAWN], None)


def test_region_that_could_not_be_measured_and_leftovers_are_not_asked_for(state, meal_of):
    speaker, _ = meal_of()
    run_id = measured_again(state, speaker)
    with state.database.write() as session:
        session.execute(sa.update(ItemMeasure).where(ItemMeasure.run_id == run_id).values(rings=[]))
    assert check_index(state.database, study_code=None) == Described(described=1)
    with state.database.write() as session:
        session.execute(sa.update(Item).values(origin="after"))
    assert check_index(state.database, study_code=None) == Described()


def test_erased_photograph_is_left_alone(state, meal_of, rebuild):
    meal_of()
    with state.database.write() as session:
        session.execute(sa.update(Study).values(retention_days=1))
    assert erase_old_pictures(state.database, datetime.now(UTC) + timedelta(days=2)) == 1
    assert check_index(state.database, study_code=None) == rebuild() == Described(gone=1)
    assert new_vectors(state) == []
    assert rows(state, IndexEntry)[0].vcm_version == "old"


def test_damaged_and_missing_photographs_are_told_and_the_others_described(state, meal_of, rebuild):
    for seed in (1, 2, 3):
        meal_of(seed)
    crashing = Children(lambda: ChildResult("crashed"))
    assert rebuild(by=crashing) == Described(unreadable=3)  # told, and not fatal
    assert new_vectors(state) == []
    damaged, missing, _ = (image for image in rows(state, MealImage) if image.slot == "left")
    state.blobs.delete(missing.blob_key)
    state.blobs.put_bytes(damaged.blob_key, b"not what was sealed")
    assert rebuild() == Described(described=1, unreadable=2)
    assert rebuild() == Described(kept=1, unreadable=2)


def test_rebuild_that_broke_off_is_gone_on_with(state, meal_of, rebuild, children):
    for seed in (1, 2):
        meal_of(seed)

    class Failing:
        left = 1

        def run(self, *arguments, **options):
            self.left -= 1
            if self.left < 0:
                raise ChildStartError("the machine is full")
            return children.run(*arguments, **options)

    with pytest.raises(UnavailableError, match="child process"):
        rebuild(by=Failing())
    assert len(new_vectors(state)) == 1
    assert rebuild() == Described(kept=1, described=1)


def test_region_that_another_command_described_meanwhile_keeps_that_vector(state, meal_of, rebuild):
    _, photo = meal_of()

    def be_overtaken():
        assert rebuild() == Described(described=1)
        return ChildResult("ok", {"failure": None, "vcms": [OLD]})

    assert rebuild(by=Children(be_overtaken)) == Described(kept=1)
    assert [row.vector for row in new_vectors(state)] == [expected(photo, [RING])]


@pytest.mark.parametrize("deed", ["erase", "anonymise"])
def test_person_who_leaves_while_their_meal_is_described_leaves_no_new_vector(deed, state, meal_of, rebuild, client):
    speaker, _ = meal_of()
    with state.database.write() as session:
        session.execute(sa.update(Study).values(withdrawal_policy=deed))

    def leave():
        assert client.post("/v1/me/withdrawal", headers=speaker.headers).status_code == 200
        return ChildResult("ok", {"failure": None, "vcms": [OLD]})

    assert rebuild(by=Children(leave)) == Described(gone=1)
    assert new_vectors(state) == []


def test_only_the_study_that_was_named_is_described(state, meal_of, rebuild):
    meal_of(1, "pilot")
    meal_of(2, "other")
    assert check_index(state.database, study_code="pilot") == Described(described=1)
    assert rebuild("pilot") == Described(described=1)
    assert check_index(state.database, study_code="other") == Described(described=1)
    with pytest.raises(NotFoundError):
        rebuild("none")


def test_command_tells_counts_and_check_says_no_while_something_is_to_do(state, meal_of, settings, monkeypatch):
    meal_of()
    for name, value in settings_environment(settings).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("app.operations.prepare.prepare", lambda *_: None)
    word = f"confirmed items have no vector of version {VCM_VERSION}"
    assert doctors_word(state, settings) == f"1 {word}: `tada index rebuild`"
    asked = CliRunner().invoke(cli, ["index", "rebuild", "--check"])
    assert (asked.exit_code, asked.stdout.splitlines()[0]) == (1, "1 regions to describe, 0 kept")
    done = CliRunner().invoke(cli, ["index", "rebuild", "--json"])
    assert (done.exit_code, done.stdout) == (0, '{"kept": 0, "described": 1, "gone": 0, "unreadable": 0}\n')
    assert CliRunner().invoke(cli, ["index", "rebuild", "--check"]).exit_code == 0
    assert doctors_word(state, settings) == f"0 {word}"


def doctors_word(state, settings):
    (finding,) = (one for one in examine(state.database, settings, requeue=False) if one.subject == "index")
    assert finding.is_ok
    return finding.message


def measured_again(state, speaker, *found, **answer):
    """The meal's item, drawn anew and measured again. Returns the run's id."""
    regions = [speaker.items()[0]["id"]]
    speaker.say("redraw", item=regions[0], polygon=DRAWN)
    return estimates.save(state, speaker.meal_id, *found, purpose="remeasure", regions=regions, **answer)


class Children:
    """A pool whose children do as they are told."""

    def __init__(self, answer):
        self._answer = answer

    def run(self, *_, **__):
        return self._answer()


def test_idle_worker_describes_one_meal_after_the_other_once_and_waits_while_a_child_is_busy(
    state, settings, meal_of, children, monkeypatch
):
    meal_of(seed=1)
    meal_of(seed=2)
    chore = DescribeIdly(state.database, state.blobs, children, settings)
    with monkeypatch.context() as patch:
        patch.setattr(ChildPool, "is_idle", False)
        chore.run()
    assert new_vectors(state) == []
    counts = []
    for _ in range(4):
        chore.run()
        counts.append(len(new_vectors(state)))
    assert counts == [1, 2, 2, 2]
    assert {entry.vcm_version for entry in rows(state, IndexEntry)} == {VCM_VERSION}
    meal_of(seed=3)
    chore.run()
    assert len(new_vectors(state)) == 2  # what comes later was described by its own run
