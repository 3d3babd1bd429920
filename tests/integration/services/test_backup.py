"""A backup restored on an empty machine is the same deployment: every row, every byte, every answer."""

import contextlib

import pytest

from app.services.restore import CHANGE_SEQ_JUMP
from tests.conftest import postgres_database
from tests.integration.persons import Person
from tests.integration.services.deployments import Deployment, deployment, named_blobs, store_what_is_named

OTHER = {"sqlite": "postgres", "postgres": "sqlite"}


@pytest.fixture
def source(state, settings) -> Deployment:
    """The deployment that the tests' phones send to."""
    return Deployment(settings, state.database, state.blobs)


@pytest.fixture
def empty_machine(request, tmp_path):
    """empty_machine("sqlite"): a new folder, a new database without tables, a new store."""
    with contextlib.ExitStack() as stack:

        def make(kind_of_database, **settings):
            folder = tmp_path / f"machine-{len(list(tmp_path.iterdir()))}"
            if kind_of_database == "sqlite":
                url = f"sqlite:///{folder / 'tada.sqlite3'}"
            else:
                url = stack.enter_context(postgres_database(request.getfixturevalue("postgres_server")))
            return stack.enter_context(deployment(folder, url, **settings))

        yield make


@pytest.fixture
def person(state, enrol, source):
    """Somebody who has a row in every table that can hold one of theirs, and the blobs that they name."""
    person = Person(state, enrol, "somebody-7Kq", seed=3)
    state.last_use.settle()
    store_what_is_named(source.database, source.blobs)
    return person


def later(rows):
    """Rows as a restore makes them: every change has a later number."""
    return {
        table: {
            key: {
                name: value + CHANGE_SEQ_JUMP if name == "change_seq" and value is not None else value
                for name, value in row.items()
            }
            for key, row in of_table.items()
        }
        for table, of_table in rows.items()
    }


def without_note(rows):
    """Rows but the restore's own event in the audit log."""
    events = {key: row for key, row in rows["audit_event"].items() if row["action"] != "server.restore"}
    assert len(rows["audit_event"]) == len(events) + 1
    return rows | {"audit_event": events}


@pytest.mark.parametrize("onto_other", [False, True], ids=["same", "other"])
def test_restored_deployment_has_every_row_and_every_byte(kind, onto_other, person, source, empty_machine, tmp_path):
    done = source.back_up(tmp_path / "one.tar")
    assert (done.damaged, done.erased) == ({}, 0)
    machine = empty_machine(OTHER[kind] if onto_other else kind)
    machine.restore(tmp_path / "one.tar")
    assert without_note(machine.rows()) == later(source.rows())
    assert machine.stored() == {key: source.blobs.read(key) for key in named_blobs(source.database)}
    assert len(machine.stored()) >= 4
