"""How much of the program one HTTP call enters: `python -m benchmarks.files_entered`.

The app runs in this process on a throwaway SQLite database. Counted are the files of app/ of which a function was
called, and the functions, in all threads, from the request to its answer; what child processes do is not. Each call is
made once before it is counted, so that what is kept for later calls is not counted.
"""

import json
import sys
import tempfile
import threading
import uuid
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType

from starlette.testclient import TestClient

from app.core.settings import Settings
from app.main import create_app
from app.people.access.staff import create_admin
from tests.support.estimates import found_item, save
from tests.support.photographs import pair

APP = str(Path(__file__).parents[1] / "app") + "/"
TARGETS = {  # files, functions: of issue 22
    "upload": (30, 150),
    "read a meal": (25, 130),
    "reviewer's set_food": (32, 200),
    "page of records": (20, None),
    "records as CSV": (22, None),
}


class Entered:
    """Functions of app/ that are called while it looks, in all threads that begin after it was made."""

    def __init__(self) -> None:
        self._functions: set[CodeType] = set()
        self._is_looking = False
        threading.setprofile(self._note)
        sys.setprofile(self._note)

    def count(self, call: Callable[[], object]) -> tuple[list[str], int]:
        """The files that a call enters and the number of its functions: comprehensions and lambdas are none."""
        self._functions.clear()
        self._is_looking = True
        call()
        self._is_looking = False
        named = {code for code in self._functions if not code.co_name.startswith("<")}
        return sorted({code.co_filename.removeprefix(APP) for code in named}), len(named)

    def _note(self, frame: FrameType, event: str, _: object) -> None:
        if self._is_looking and event == "call" and frame.f_code.co_filename.startswith(APP):
            self._functions.add(frame.f_code)


def upload(client: TestClient, headers: dict[str, str], seed: int) -> str:
    """Send a meal; its id."""
    body = {
        "id": str(uuid.uuid4()),
        "captured_at": "2026-11-20T12:30:00+08:00",
        "time_zone": "Asia/Shanghai",
    }
    files = {"metadata": ("m.json", json.dumps(body), "application/json")}
    files |= {slot: (slot, content, "image/jpeg") for slot, content in pair(seed).items()}
    answer = client.post("/v1/meals", headers=headers, files=files)
    answer.raise_for_status()
    return body["id"]


def set_food(
    client: TestClient, headers: dict[str, str], meal: str, food: str
) -> Callable[[], object]:
    """What a reviewer does who names another food; the meal was read before."""
    shown = client.get(f"/v1/meals/{meal}", headers=headers).json()
    event = {
        "id": str(uuid.uuid4()),
        "kind": "set_food",
        "item": shown["items"][0]["id"],
        "food": food,
    }
    condition = {"If-Match": f'"{shown["version"]}"'}
    return lambda: client.post(
        f"/v1/meals/{meal}/events", headers=headers | condition, json=event
    ).raise_for_status()


def main() -> None:
    """Print the table; with -v the files too."""
    entered = Entered()
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings())
        app.state.settings = Settings(
            data_dir=Path(folder), secret_key="for this run only" * 2, min_free_bytes=0
        )
        with TestClient(app) as client:
            admin = {"Authorization": f"Bearer {create_admin(app.state.api.database, 'admin')}"}
            client.post(
                "/v1/studies",
                headers=admin,
                json={"code": "a", "name": "a", "marker": "plain:9x7:11"},
            )
            client.post("/v1/studies/a/participants", headers=admin, json={"code": "P"})
            code = client.post(
                "/v1/studies/a/participants/P/enrolment-codes", headers=admin
            ).json()["code"]
            token = client.post("/v1/enrolments", json={"code": code, "device_name": "d"}).json()[
                "token"
            ]
            phone = {"Authorization": f"Bearer {token}"}
            meal, reviewed = (upload(client, phone, seed) for seed in range(2))
            for each in (meal, reviewed):
                save(app.state.api, each, found_item(hint=None))

            def get(path: str, headers: dict[str, str]) -> Callable[[], object]:
                return lambda: client.get(path, headers=headers).raise_for_status()

            calls: dict[str, Callable[[int], Callable[[], object]]] = {
                "upload": lambda turn: lambda: upload(client, phone, 100 + turn),
                "read a meal": lambda _: get(f"/v1/meals/{meal}", phone),
                "reviewer's set_food": lambda turn: set_food(
                    client, admin, reviewed, ("apple", "banana")[turn]
                ),
                "page of records": lambda _: get("/v1/records?study=a", admin),
                "records as CSV": lambda _: get("/v1/records?study=a&format=csv", admin),
            }
            print("| call | files (target) | functions (target) |\n|---|---|---|")
            for name, prepare in calls.items():
                prepare(0)()
                files, functions = entered.count(prepare(1))
                most_files, most_functions = TARGETS[name]
                print(
                    f"| {name} | {len(files)} ({most_files}) | {functions} ({most_functions or '-'}) |"
                )
                if "-v" in sys.argv:
                    print("\n".join(files))


if __name__ == "__main__":
    main()
