"""What a server keeps in memory that began on an empty folder and has taken a meal: not what others do for it."""

import json
import re
import uuid
from pathlib import Path

import pytest

import app
from tests.e2e.processes import Server, enrolled_client

PHOTOS = Path(app.__file__).parent / "demo_data"
OTHERS = {"cv2", "opencv_python_headless.libs", "numpy", "scipy", "PIL", "pyarrow", "obstore", "duckdb"}
MOST_MB = 180.0  # seen: 136; 290 while it migrated, hashed a password and had OpenCV by itself


@pytest.mark.slow
def test_server_that_took_a_meal_has_loaded_nothing_that_others_do(tmp_path):
    server = Server(tmp_path, "--no-worker")
    server.start()
    try:
        server.wait_until_ready()
        with enrolled_client(server) as phone:
            metadata = {
                "id": str(uuid.uuid4()),
                "captured_at": "2026-11-20T12:30:00+08:00",
                "time_zone": "Asia/Shanghai",
            }
            files = {
                slot: (f"{slot}.jpg", (PHOTOS / f"{slot}.jpg").read_bytes(), "image/jpeg") for slot in ("left", "right")
            }
            sent = phone.post(
                "/v1/meals", files={"metadata": (None, json.dumps(metadata), "application/json"), **files}
            )
        assert sent.status_code == 202, sent.text
        maps = Path(f"/proc/{server.process.pid}/maps").read_text()
        status = Path(f"/proc/{server.process.pid}/status").read_text()
    finally:
        server.stop()
    loaded = set(re.findall(r"/site-packages/([^/\s]+)/", maps))
    assert "cryptography" in loaded
    assert not loaded & OTHERS
    peak_mb = int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) * 1024 / 1e6
    assert peak_mb < MOST_MB
