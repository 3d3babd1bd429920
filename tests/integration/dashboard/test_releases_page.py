"""The releases' pages: figures, files and checksums are the API's; owners freeze."""

import re

import pytest
import sqlalchemy as sa

from app.exports.release_models import ReleaseFile
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.diary.eaten_days import add_meal, eaten_item

PATH = "/dashboard/studies/pilot/releases"
API = "/v1/studies/pilot/releases"
NOTE = 'For "the paper" <script>alert(1)</script>'
pytestmark = pytest.mark.usefixtures("meals")


@pytest.fixture
def meals(phone, enrol, state):
    """Two meals: the id of the first, that of the phone."""
    enrol("P002")
    first = add_meal(state, "P001", "2026-11-01", eaten_item(100.0, "apple", energy_kcal=52.0))
    add_meal(state, "P002", "2026-11-02", eaten_item(50.0, "banana"), eaten_item(None))
    return first


@pytest.fixture
def ready(owner, run):
    """A release that is there."""
    answer = owner.post(PATH, name="2026-baseline", note=NOTE, to="2026-11-02", **{"from": ""})
    assert (answer.status_code, answer.headers["location"]) == (303, f"{PATH}/2026-baseline")
    assert run().outcome == "done"
    return f"{PATH}/2026-baseline"


def test_every_figure_of_a_release_is_the_apis_and_its_files(client, admin, owner, ready):
    page = owner.page(ready)
    told = client.get(f"{API}/2026-baseline", headers=admin).json()
    manifest = client.get(f"{API}/2026-baseline/files/datapackage.json", headers=admin).json()["tada"]
    files = [value for file in told["files"] for value in (file["rows"], file["bytes"]) if value is not None]
    contents = manifest["contents"]
    made_of = [count for name in ("pipeline_versions", "methods", "food_tables") for count in contents[name].values()]
    expected = [told["rows"], told["bytes"], *files, *made_of, contents["foods"], told["change_seq"]]
    assert figures_of(page) == expected
    assert contents["food_tables"], "the two foods have a table"
    for shown in (told["checksum"], *(file["sha256"] for file in told["files"]), *contents["food_tables"]):
        assert shown in page
    assert "<script>alert" not in page
    rows = {file["name"]: file["rows"] for file in told["files"]}
    methods = text_of(re.search(r'<p class="note" id="methods">(.*?)</p>', page, re.DOTALL)[1])
    assert f"beside a reference of known size ({manifest['protocol']['marker']}). Food volumes" in methods
    assert (
        f"with tada-server {manifest['program']}; pipeline versions, with numbers of items: none; methods: none."
        in methods
    )
    tables = ", ".join(f"{name} ({count})" for name, count in contents["food_tables"].items())
    assert f"those of 2 foods of these food tables, with numbers of items: {tables}. A day begins at 00:00" in methods
    assert f"local days from the first to 2026-11-02; {rows['days.csv']} days; {rows['items.csv']} items" in methods
    assert methods.strip().endswith(f"participants), SHA-256 {told['checksum']}.")
    listed = owner.page(PATH)
    assert figures_of(listed) == [told["rows"], told["bytes"]]
    assert told["checksum"] in listed
    for file in told["files"]:
        assert owner.get(f"{ready}/files/{file['name']}").content == client.get(file["path"], headers=admin).content


def test_page_follows_a_release_until_it_is_ready(owner, run):
    assert owner.post(PATH, name="one").status_code == 303
    waiting = owner.page(f"{PATH}/one")
    assert f'hx-get="{PATH}/one/state"' in waiting
    assert f'hx-get="{PATH}-list"' in owner.page(PATH)
    fragment = {"HX-Request": "true"}
    assert "queued" in owner.get(f"{PATH}/one/state", headers=fragment).text
    assert run().outcome == "done"
    assert owner.get(f"{PATH}/one/state", headers=fragment).headers["hx-redirect"] == f"{PATH}/one"
    assert "hx-get" not in owner.page(f"{PATH}/one")


def lose(state, name):
    """Delete a file of the release from the store."""
    with state.database.read() as session:
        keys = {file.name: file.blob_key for file in session.scalars(sa.select(ReleaseFile))}
    state.blobs.delete(keys[name])


def test_check_names_the_damaged_file(state, owner, ready):
    assert "each is as frozen" in owner.page(f"{ready}/check")
    lose(state, "items.csv")
    page = owner.page(f"{ready}/check")
    assert "differ from the frozen ones" in page
    states = dict(re.findall(r'download>([\w.-]+)</a>.*?status-(?:done|failed)">(\w+)<', page, re.DOTALL))
    assert states.pop("items.csv") == "missing"
    assert set(states.values()) == {"whole"}


def test_erasure_is_shown_with_the_former_checksum(client, admin, meals, owner, ready, run, phone):
    before = client.get(f"{API}/2026-baseline", headers=admin).json()["checksum"]
    assert client.delete(f"/v1/meals/{meals}", headers=phone.headers).status_code == 200
    changing = owner.page(ready)
    assert "Something in it was erased" in changing
    assert "items.parquet" not in changing
    assert run().outcome == "done"
    page = owner.page(ready)
    after = client.get(f"{API}/2026-baseline", headers=admin).json()["checksum"]
    assert after != before
    assert "Altered." in page
    assert before in page
    assert re.search(rf'id="checksum">{after}<', page)
    assert "altered" in text_of(owner.page(PATH))


def test_viewer_reads_and_does_not_freeze_and_another_study_has_none_of_it(enrol, sign_in_browser, ready):
    enrol("X1", study="other")
    viewer = sign_in_browser("vera", pilot="viewer", other="owner")
    assert "Freeze the current data" not in viewer.page(PATH)
    assert "items.parquet" in viewer.page(ready)
    for path in (ready, f"{ready}/state", f"{ready}/check", f"{ready}/files/items.csv"):
        assert viewer.get(path.replace("/pilot/", "/other/")).status_code == 404, path
