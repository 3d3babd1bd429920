"""Remeasurements without worker processes: pairs are fed and answered as workers do, one after the other."""

from datetime import UTC, datetime

from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals.stored.job_models import LIVE_STATES, Job
from app.meals.stored.models import Meal
from app.records.remeasurements.remeasurements import FeedWorkers
from tests.support import estimates

PATH = "/v1/studies/pilot/remeasurements"


class Again:
    """The remeasurements of one study, by HTTP, and their work."""

    def __init__(self, client, headers, state):
        self.client, self.headers, self.state = client, headers, state
        self.feed = FeedWorkers(state.database, JobQueue())

    def start(self, status=202, **body):
        answer = self.client.post(PATH, headers=self.headers, json=body)
        assert answer.status_code == status, answer.text
        return answer.json()

    def get(self, remeasurement_id, suffix="", **params):
        return self.client.get(f"{PATH}/{remeasurement_id}{suffix}", headers=self.headers, params=params)

    def deed(self, remeasurement_id, deed, status=200):
        answer = self.client.post(f"{PATH}/{remeasurement_id}/{deed}", headers=self.headers)
        assert answer.status_code == status, answer.text
        return answer.json()

    def live(self):
        """(meal's id as the phone made it, purpose) of the background jobs that are not done."""
        with self.state.database.read() as session:
            query = session.query(Meal.client_id, Job.purpose).join(Job, Job.meal_id == Meal.id)
            rows = query.filter(Job.is_background, Job.state.in_(LIVE_STATES)).order_by(Job.enqueued_at).all()
        return [(str(meal), purpose) for meal, purpose in rows]

    def measure(self, answers):
        """Feed and answer until nothing is left. answers: (meal's id, purpose) -> items, or keywords of the answer."""
        while self.feed(1):
            (job,) = self.live()
            given = answers[job]
            items, changes = (given, {}) if isinstance(given, list) else ([], given)
            estimates.save(self.state, job[0], *items, purpose=job[1], **changes)

    def fail(self, failure):
        """Fail the background jobs that are not done, as a worker does."""
        with self.state.database.write() as session:
            for job in session.query(Job).filter(Job.is_background, Job.state.in_(LIVE_STATES)):
                jobs.fail_job(job, session.get_one(Meal, job.meal_id), failure, datetime.now(UTC))

    def done(self, answers, **body):
        """A remeasurement from start to end: (its numbers, the rows of its table)."""
        started = self.start(**body)
        self.measure(answers)
        numbers = self.get(started["id"]).json()
        assert numbers["state"] == "done", numbers
        return numbers, self.get(started["id"], "/items").json()["items"]
