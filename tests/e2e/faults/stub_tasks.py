"""What the estimate's child does here: pictures with a note as it says, all others by the real pipeline."""

import hashlib
import os
import pathlib
import signal
import time

from app.meals.estimate.child_tasks import TASKS as REAL_TASKS
from tests.e2e.faults.child_at_work import named_after
from tests.e2e.faults.pictures import note_of, volumes_ml
from tests.support.estimates import answer, found_item

PIECES = 5  # of the time, so that progress is told in between
STAGES = ("read", "marker", "match", "depth", "volume")


def estimate(request, on_stage):
    left, right = (pathlib.Path(path).read_bytes() for path in request["photographs"].values())
    with named_after(left):
        return _estimate(request, on_stage, left, right)


def _estimate(request, on_stage, left, right):
    note = note_of(left)
    if note is None:
        return REAL_TASKS["estimate"](request, on_stage)
    for stage in STAGES:
        on_stage(stage)
        time.sleep(note.seconds / PIECES)
    if note.crashes:
        os.kill(os.getpid(), signal.SIGSEGV)  # as a decoder does that a picture leads astray
    picture = left[: len(left) // 2]
    (pathlib.Path(request["output_dir"]) / "overlay.jpg").write_bytes(picture)
    artefact = {
        "name": "overlay.jpg",
        "media_type": "image/jpeg",
        "bytes": len(picture),
        "sha256": hashlib.sha256(picture).hexdigest(),
    }
    hinted = len(request["options"]["hints"])
    items = [
        found_item(volume, hint=place if place < hinted else None)
        for place, volume in enumerate(volumes_ml(left, right, note.items))
    ]
    return answer(*items, artefacts=[artefact])


TASKS = {**REAL_TASKS, "estimate": estimate}
