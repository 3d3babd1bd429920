"""The child processes' tasks by name: everything that decodes uploaded bytes.

JSON in, JSON out, files by path.
"""

from collections.abc import Mapping

from app.candidates.confusions import rank_task
from app.children.child import Task
from app.meals.estimate.barcode_task import barcode_task
from app.meals.estimate.calibrate import calibrate_task
from app.meals.estimate.photo_tasks import check_task, classify_task, describe_task, picture_task
from app.meals.estimate.receive_task import inspect_task, receive_task
from app.meals.estimate.run_estimate import estimate_task

TASKS: Mapping[str, Task] = {
    "estimate": estimate_task,
    "check": check_task,
    "receive": receive_task,
    "inspect": inspect_task,
    "calibrate": calibrate_task,
    "picture": picture_task,
    "describe": describe_task,
    "classify": classify_task,
    "rank": rank_task,
    "barcode": barcode_task,
}
