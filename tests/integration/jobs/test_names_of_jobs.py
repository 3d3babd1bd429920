"""What a worker's log can tell of a job: its meal, and the request that queued it."""

import uuid

import pytest
import structlog

from app.jobs.queries import names_of_job
from tests.integration.jobs.fakes import new_job


def names(jobs, job_id):
    with jobs.database.read() as session:
        return names_of_job(session, job_id)


def test_job_names_its_meal_and_the_request_that_queued_it(jobs):
    request_id = uuid.uuid4().hex
    with structlog.contextvars.bound_contextvars(request_id=request_id):
        job_id = jobs.add()
    found = names(jobs, job_id)
    assert (found.meal_id, found.purpose) == (jobs.meal(job_id).id, "meal")
    assert (found.request_id, found.attempts) == (request_id, 0)


@pytest.mark.both_stores
def test_job_that_no_request_queued_names_its_meal_only(jobs):
    with jobs.database.write() as session:
        job_id = new_job(session, jobs.queue)
    assert names(jobs, job_id).request_id is None


@pytest.mark.both_stores
def test_job_that_is_gone_has_no_names(jobs):
    assert names(jobs, uuid.uuid4()) is None
