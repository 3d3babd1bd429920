"""The pipeline's answer as the child sends it, made up: what the services do with it does not depend on vision."""

import base64
import hashlib
import json
import uuid
from datetime import UTC, datetime

import numpy as np

from app.jobs import queries as jobs
from app.meals.estimate.save_estimate import save_estimate
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.run_answer import RunAnswer
from app.vision.looks.vcm import VCM_VERSION


def found_item(volume_ml=185.0, hint=0, **changes):
    item = {
        "polygon": [[10.0, 10.0], [50.0, 10.0], [50.0, 50.0]],
        "volume_ml": volume_ml,
        "volume_interval_ml": [0.9 * volume_ml, 1.1 * volume_ml],
        "relative_sd": {"pair": 0.02, "item": 0.06},
        "candidates": [],
        "hint": hint,
        "flags": [],
        "traits": {"centre_mm": None, "radius_mm": None, "lab": None},
    }
    return item | changes


def unmeasured_item(hint=0):
    """An item that is there, and how much of it cannot be told."""
    unknown = {"volume_ml": None, "volume_interval_ml": None, "relative_sd": {}, "flags": ["not_measurable"]}
    return found_item(hint=hint) | unknown


def vcm(*numbers, version=VCM_VERSION):
    """What an item looks like, as the child describes it."""
    return {"version": version, "vector": base64.b64encode(np.array(numbers, "<f2").tobytes()).decode()}


def identified_item(probabilities, none=0.0, volume_ml=185.0, hint=None, specimens=9, **changes):
    """An item of which the index has said what it may be, by food's key, as the worker seals it.

    specimens: that each food is known by.
    """
    return found_item(
        volume_ml,
        hint,
        **{
            "vcm": vcm(0.0, 0.5, 1.0),
            "candidates": [{"food": key, "probability": p, "specimens": specimens} for key, p in probabilities.items()],
            "none_probability": none,
            "index_version": "test 1",
        }
        | changes,
    )


def answer(*items, **changes):
    body = {
        "items": list(items),
        "failure": None,
        "marker": "plain:9x7:11",
        "camera": None,
        "camera_right": None,
        "stages": {"read": 0.1, "marker": 0.2},
        "seconds": 0.3,
        "method": "paper",
        "pipeline_version": "test",
        "parameters": {},
        "artefacts": [],
    }
    return body | changes


def scene_artefact(state, content=b"{}"):
    """A sealed scene.json, as the answer lists it."""
    key = f"pictures/{uuid.uuid4().hex}/scene.json"
    state.blobs.put_bytes(key, content)
    sha256 = hashlib.sha256(content).hexdigest()
    return {
        "name": "scene.json",
        "media_type": "application/json",
        "bytes": len(content),
        "sha256": sha256,
        "blob_key": key,
    }


def seen_item(x, y, lab, volume_ml=185.0, hint=None, **changes):
    """An item whose place (mm, table frame) and colour (CIELAB) are known."""
    traits = {"centre_mm": [x, y], "radius_mm": 30.0, "lab": list(lab)}
    return found_item(volume_ml, hint, traits=traits, **changes)


def save(state, meal_client_id, *items, purpose="meal", **changes):
    """Save an answer for a meal's newest job of this purpose, in the way of the worker."""
    body = answer(*items, **changes)
    key = f"results/{uuid.uuid4().hex}/{hashlib.sha256(json.dumps(body).encode()).hexdigest()}"
    with state.database.write() as session:
        job = (
            session.query(Job)
            .join(Meal, Meal.id == Job.meal_id)
            .filter(Meal.client_id == uuid.UUID(str(meal_client_id)), Job.purpose == purpose)
            .order_by(Job.enqueued_at.desc())
            .first()
        )
        assert job is not None, f"the meal has no job for {purpose}"
        save_estimate(session, job.id, RunAnswer.model_validate(body), key)
        jobs.finish_job(job, datetime.now(UTC))
        return job.id
