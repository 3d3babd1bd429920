"""What a worker's log can tell of a job: its meal, and the request that queued it."""

import uuid

import pytest
import structlog

from app.jobs.queries import names_of_job


@pytest.mark.both_stores
def test_job_names_its_meal_and_the_request_that_queued_it_if_one_did_and_one_that_is_gone_nothing(jobs):
    request_id = uuid.uuid4().hex
    with structlog.contextvars.bound_contextvars(request_id=request_id):
        job_id = jobs.add()
    by_no_request = jobs.add()
    with jobs.database.read() as session:
        found = names_of_job(session, job_id)
        assert (found.meal_id, found.purpose) == (jobs.meal(job_id).id, "meal")
        assert (found.request_id, found.attempts) == (request_id, 0)
        assert names_of_job(session, by_no_request).request_id is None
        assert names_of_job(session, uuid.uuid4()) is None
