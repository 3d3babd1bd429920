"""An operator's network in the worker, from the photograph that arrived to the candidates that people see."""

import hashlib
from datetime import UTC, datetime

import numpy as np
import pytest
import sqlalchemy as sa

from app.children.child_pool import ChildResult
from app.jobs import queries as jobs
from app.meals.estimate.child_tasks import TASKS
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.stored.job_models import Job
from app.operations.doctor.doctor_settings import look_at_classifier
from app.operations.doctor.finding import Deployment
from tests.integration.conftest import meal_metadata
from tests.support.estimates import answer, found_item
from tests.support.onnx_models import colour_classifier
from tests.support.photographs import pair


class SeeingChildren:
    """Children that estimate one made-up item, and do all else in this process."""

    def run(self, request, on_stage, *, seconds=None, name=None, is_alone=False):
        if request.task == "estimate":
            ring = [[10.0, 10.0], [300.0, 10.0], [300.0, 300.0], [10.0, 300.0]]
            return ChildResult("ok", answer(found_item(hint=None, polygon=ring)))
        return ChildResult("ok", TASKS[request.task](request.arguments, on_stage))


@pytest.fixture
def serve(state, settings, phone, tmp_path):
    """Estimate a new meal with this model in the file and this description; returns the meal as the API shows it."""

    def serve(model, described):
        (tmp_path / "m.onnx").write_bytes(model)
        (tmp_path / "l.csv").write_text("label,food_key\na,apple\nb,pear\n")
        digest = hashlib.sha256(described).hexdigest()
        toml = f'model = "m.onnx"\nsha256 = "{digest}"\nlabels = "l.csv"\nwidth_px = 8\nheight_px = 8\n'
        (tmp_path / "c.toml").write_text(toml)
        ours = settings.model_copy(update={"classifier": tmp_path / "c.toml"})
        worker = EstimatePair(state.database, state.blobs, SeeingChildren(), ours)
        body = meal_metadata()
        assert phone.post(pair(), body).status_code == 202
        with state.database.read() as session:
            job_id = session.scalars(sa.select(Job).where(Job.state == "queued")).one().id
        key = worker.compute(job_id)
        with state.database.write() as session:
            worker.save(session, job_id, worker.load(key))
            jobs.finish_job(session.get_one(Job, job_id), datetime.now(UTC))
        return phone.client.get(f"/v1/meals/{body['id']}", headers=phone.headers).json(), ours

    return serve


def test_network_s_candidates_reach_the_meal_and_a_changed_file_costs_it_nothing(serve, state):
    model = colour_classifier(np.array([[2.0, 0.0], [2.0, 0.0], [2.0, 0.0]]))
    meal, settings = serve(model, model)
    (item,) = meal["items"]
    shown = [(each["food"]["key"], each["source"]) for each in item["candidates"]]
    assert shown == [("apple", "model"), ("pear", "model")]
    assert meal["run"]["parameters"]["classifier"]["version"] == f"m {hashlib.sha256(model).hexdigest()[:12]}"
    assert look_at_classifier(Deployment(state.database, settings, requeue=False))[0] == "ok"

    meal, _ = serve(model + b"changed", model)
    (item,) = meal["items"]
    assert item["candidates"] == []
    assert item["volume_ml"] > 0
    assert meal["run"]["parameters"]["classifier"]["failure"] == "classifier_digest_differs"
