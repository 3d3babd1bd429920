"""What a worker's log can tell of a job: the request that queued it."""

import uuid

import pytest
import structlog

from app.meals.stored.job_models import Job


@pytest.mark.both_stores
def test_job_names_the_request_that_queued_it_if_one_did(jobs):
    request_id = uuid.uuid4().hex
    with structlog.contextvars.bound_contextvars(request_id=request_id):
        job_id = jobs.add()
    by_no_request = jobs.add()
    with jobs.database.read() as session:
        assert session.get(Job, job_id).request_id == request_id
        assert session.get(Job, by_no_request).request_id is None
