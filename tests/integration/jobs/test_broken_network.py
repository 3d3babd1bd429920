"""A network that breaks off without a word: no packet says that the database is gone, so the kernel has to ask."""

import pytest

from app.db.session import TCP_LIVENESS
from app.jobs.engine import _dbos_engine


@pytest.mark.parametrize("kind", ["postgres"])
def test_connections_of_the_queue_notice_a_dead_network_as_ours_do(jobs):
    queue = _dbos_engine(jobs.database)
    try:
        for engine in (queue, jobs.database.write_engine):
            with engine.connect() as connection:
                told = connection.connection.driver_connection.info.get_parameters()
            assert {name: told[name] for name in TCP_LIVENESS} == {k: str(v) for k, v in TCP_LIVENESS.items()}
            assert int(told["connect_timeout"]) > 0
    finally:
        queue.dispose()
