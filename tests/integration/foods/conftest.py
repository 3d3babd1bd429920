"""The API as an admin uses it to edit foods."""

import pytest

from tests.integration.foods.editing import QUARK
from tests.support.commands import run_tada


@pytest.fixture
def staff(client, admin):
    """The API as an admin uses it."""

    class Staff:
        def get(self, path):
            return client.get(path, headers=admin)

        def post(self, path, body, **headers):
            return client.post(path, headers=admin | headers, json=body)

        def food(self, **changes):
            return self.post("/v1/foods", {k: v for k, v in (QUARK | changes).items() if v is not None})

        def patch(self, key, tag=None, **body):
            tag = tag or client.get(f"/v1/foods/{key}", headers=admin).headers["etag"]
            return client.patch(f"/v1/foods/{key}", headers=admin | {"If-Match": tag}, json={"reason": "a test"} | body)

        def nutrients(self, key):
            return {row["number"]: row["per_100_g"] for row in self.get(f"/v1/foods/{key}").json()["nutrients"]}

    return Staff()


@pytest.fixture
def tada(prepared_database_url, tmp_path):
    """`tada foods ...` on the test's own database."""

    def run(*arguments, stdin=""):
        places = {"TADA_DATABASE_URL": prepared_database_url, "TADA_DATA_DIR": tmp_path / "data"}
        return run_tada("foods", *arguments, stdin=stdin, **places)

    return run
