"""The capture page's files over HTTP: headers, the client's modules, the service worker, and nothing besides."""

import json
import re

import pytest
from starlette.applications import Starlette
from starlette.testclient import TestClient

from app.capture import files
from app.capture.files import HEADERS, PATH, STATIC, CaptureFiles, service_worker


@pytest.fixture
def client():
    app = Starlette()
    app.mount(PATH, CaptureFiles())
    return TestClient(app)


@pytest.mark.parametrize("path", ["/", "/client/index.js", "/service-worker.js"])
def test_every_answer_has_the_page_s_headers(client, path):
    answer = client.get(PATH + path)
    assert {name: answer.headers[name] for name in HEADERS} == dict(HEADERS)


@pytest.mark.parametrize(
    "path",
    [
        "/.hidden",
        "/client/schema.d.ts",
        "/client/../../../pyproject.toml",
        "/../files.py",
        "/client",
    ],
)
def test_nothing_besides_the_page_is_served(client, path):
    assert client.get(PATH + path).status_code == 404


def test_service_worker_keeps_every_file_that_the_page_can_ask_for(client):
    listed = re.search(r'"files": (\[.*?\])', service_worker().decode()).group(1)
    names = re.findall(r'"([^"]*)"', listed)
    assert {"", "main.js", "client/index.js", "texts/zh.json", "live/frame_worker.js"} <= set(names)
    for name in names:
        assert client.get(f"{PATH}/{name}").status_code == 200, name


def test_service_worker_holds_the_texts_of_notifications_in_every_language():
    shell = json.loads(service_worker().decode().partition(" = ")[2].partition(";\n")[0])
    for path in (STATIC / "texts").glob("*.json"):
        texts = json.loads(path.read_text(encoding="utf-8"))
        assert shell["texts"][path.stem] == {key: texts[key] for key in ("title", "remind_meal", "remind_after_meal")}


def test_changed_file_gives_another_version_of_the_service_worker(tmp_path, monkeypatch):
    (tmp_path / "index.html").write_text("one")
    (tmp_path / "service-worker.js").write_text("script")
    monkeypatch.setattr(files, "STATIC", tmp_path)
    before = service_worker.__wrapped__()
    assert service_worker.__wrapped__() == before
    (tmp_path / "index.html").write_text("two")
    assert service_worker.__wrapped__() != before
