"""The real program with a worker that computes the estimate of the same photographs once.

`python -m tests.e2e.recalling COMMAND...` is `tada COMMAND...`, for tests of apps and clients and for benchmarks, which
send the bundled pairs again and again. Answers are kept in TMPDIR, which children inherit: a folder of the caller's.
"""

import contextlib
import functools
import hashlib
import json
import pathlib
import shutil
import sys
import tempfile

from app.meals.estimate.child_tasks import TASKS as REAL_TASKS

ANSWER = "answer.json"  # beside the pictures
WITHOUT_EFFECT = ("output_dir",)  # on an estimate


def estimate(request, on_stage):
    """Return the pipeline's answer for the same photographs and options; compute it the first time."""
    output, folder = pathlib.Path(request["output_dir"]), pathlib.Path(tempfile.gettempdir())
    kept = folder / f"estimate-{key_of(request)}"
    if not kept.is_dir():
        before = set(output.iterdir())
        answer = REAL_TASKS["estimate"](request, on_stage)
        part = pathlib.Path(tempfile.mkdtemp(dir=folder))
        for path in set(output.iterdir()) - before:
            shutil.copy(path, part)
        (part / ANSWER).write_text(json.dumps(answer))
        with contextlib.suppress(OSError):  # another child was quicker
            part.rename(kept)
        return answer
    for path in kept.iterdir():
        if path.name != ANSWER:
            shutil.copy(path, output)
    return json.loads((kept / ANSWER).read_text())


def key_of(request):
    """Return the digest of all that an estimate depends on: the files' bytes instead of their paths."""

    def by_content(value):
        if isinstance(value, dict):
            return {name: by_content(each) for name, each in value.items() if name not in WITHOUT_EFFECT}
        if isinstance(value, str) and pathlib.Path(value).is_absolute() and pathlib.Path(value).is_file():
            return hashlib.sha256(pathlib.Path(value).read_bytes()).hexdigest()
        return value

    return hashlib.sha256(json.dumps(by_content(request), sort_keys=True).encode()).hexdigest()


TASKS = {**REAL_TASKS, "estimate": estimate}


def main():
    from app import worker
    from app.cli import serving
    from app.cli.main import main as tada

    worker.TASKS = "tests.e2e.recalling:TASKS"
    serving.WorkerProcess = functools.partial(
        serving.WorkerProcess, command=[sys.executable, "-m", "tests.e2e.recalling"]
    )
    if sys.argv[1:2] == ["--parent"]:  # what a server adds to its worker's command
        worker.main()
    else:
        tada()


if __name__ == "__main__":
    main()
