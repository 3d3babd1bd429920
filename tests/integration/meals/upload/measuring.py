"""Meals measured as a worker does, without a child process; and what the child was asked."""

import json
import pathlib
import uuid

from app.children.child_pool import ChildResult
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from tests.support.estimates import answer


class RecordingChildren:
    """Answers with these items, or as `run` does, and keeps the options and the bytes of the files."""

    def __init__(self, *items, run=None):
        self.items, self._run = items, run

    def run(self, request, on_stage, *, seconds=None, name="", is_alone=False):
        on_stage("read")
        arguments = json.loads(json.dumps(request.arguments))  # as the pipe to a child gives them
        self.options, self.depths = arguments["options"], arguments["depths"]
        self.photographs = {view: pathlib.Path(path).read_bytes() for view, path in arguments["photographs"].items()}
        self.maps = {
            f"{view} {kind}": pathlib.Path(files[kind]).read_bytes()
            for view, files in self.depths.items()
            for kind in ("depth", "confidence")
            if files[kind] is not None
        }
        if self._run is not None:
            return ChildResult("ok", self._run(arguments, on_stage))
        rig, camera = self.options["rig"], self.options["camera"]
        sides = {"camera": rig["left"] if rig else camera, "camera_right": rig["right"] if rig else camera}
        return ChildResult("ok", answer(*self.items, marker=self.options["marker"], **sides))


def estimate(state, settings, meal_id, *items, purpose="meal", run=None):
    """Estimate the newest job of a meal and save it; returns the children."""
    children = RecordingChildren(*items, run=run)
    use_case = EstimatePair(state.database, state.blobs, children, settings)
    with state.database.read() as session:
        jobs = session.query(Job).join(Meal, Meal.id == Job.meal_id).order_by(Job.enqueued_at.desc())
        job_id = jobs.filter(Meal.client_id == uuid.UUID(meal_id), Job.purpose == purpose).first().id
    children.key = use_case.compute(job_id)
    with state.database.write() as session:
        use_case.save(session, job_id, use_case.load(children.key))
    return children
