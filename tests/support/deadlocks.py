"""A deadlock that a test can rely on: another thread has a meal and wants its person, a call has them the other way."""

import contextlib
import threading
from concurrent.futures import ThreadPoolExecutor

import sqlalchemy as sa

from app.meals.stored import queries as meals
from tests.support.waiting import PATIENCE_SECONDS, wait_for_blocked_transaction


@contextlib.contextmanager
def deadlock_over_a_meal(database, meal_id, lock_person):
    """Within it, the first transaction that has the person and locks the meal is ended by PostgreSQL as a deadlock.

    It waits with the meal until the other waits for the person, and so closes the circle; PostgreSQL ends who notices
    first, after a second of waiting, and the other looks an hour later. On SQLite it just waits for its turn.
    lock_person(session, participant_id): how the other wants the person.
    """
    has_meal, has_person = threading.Event(), threading.Event()

    def hold():
        with database.write() as session:
            if not database.is_sqlite:
                session.execute(sa.text("SET LOCAL deadlock_timeout = '1h'"))
            person = meals.lock_meal(session, meal_id).participant_id
            has_meal.set()
            if database.is_sqlite:
                wait_for_blocked_transaction(database)
            else:
                assert has_person.wait(PATIENCE_SECONDS)
            lock_person(session, person)

    def close_the_circle(_connection, _cursor, statement, *_):
        locks_meals = "FROM meal " in statement and "FOR UPDATE" in statement
        if locks_meals and has_meal.is_set() and not has_person.is_set():
            has_person.set()
            wait_for_blocked_transaction(database)

    sa.event.listen(database.write_engine, "before_cursor_execute", close_the_circle)
    try:
        with ThreadPoolExecutor(1) as pool:
            holding = pool.submit(hold)
            assert has_meal.wait(PATIENCE_SECONDS)
            yield
            holding.result(PATIENCE_SECONDS)
    finally:
        sa.event.remove(database.write_engine, "before_cursor_execute", close_the_circle)
    assert database.is_sqlite or has_person.is_set()
