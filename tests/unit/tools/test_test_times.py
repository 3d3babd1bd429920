"""The tables of docs/tests.md: what the tests take, by folder, and the slowest."""

import json

from tools import test_times


def test_seconds_are_summed_by_folder_and_test_and_the_text_above_stays(tmp_path, monkeypatch):
    rows = [
        ("tests/unit/jobs/test_a.py::test_slow", "setup", 1.0),
        ("tests/unit/jobs/test_a.py::test_slow", "call", 2.0),
        ("tests/unit/jobs/test_b.py::test_quick", "call", 0.5),
        ("tests/e2e/test_c.py::test_whole", "call", 10.0),
    ]
    times, page = tmp_path / "times.jsonl", tmp_path / "tests.md"
    times.write_text("".join(json.dumps({"test": t, "when": w, "seconds": s}) + "\n" for t, w, s in rows))
    page.write_text(f"# Words\n\n{test_times.TABLES}an older table\n")
    monkeypatch.setattr(test_times, "PAGE", page)
    test_times.main(times, 90.0)
    text = page.read_text()
    assert text.startswith(f"# Words\n\n{test_times.TABLES}\n3 tests in 1.5 minutes on ")
    assert "an older table" not in text
    lines = text.splitlines()
    assert lines.index("| e2e | 1 | 0.0 | 10.0 | 0.0 |") < lines.index("| unit/jobs | 2 | 1.0 | 2.5 | 0.0 |")
    assert "| all | 3 | 1.0 | 12.5 | 0.0 |" in lines
    assert lines[-3:] == [
        "| `e2e/test_c.py::test_whole` | 0.0 | 10.0 | 0.0 |",
        "| `unit/jobs/test_a.py::test_slow` | 1.0 | 2.0 | 0.0 |",
        "| `unit/jobs/test_b.py::test_quick` | 0.0 | 0.5 | 0.0 |",
    ]
