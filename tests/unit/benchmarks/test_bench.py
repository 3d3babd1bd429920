import json

from benchmarks.bench import DOCUMENT, FIGURES, ROWS, table


def test_row_has_the_ratio_of_now_to_the_last_release_and_the_page_is_the_table_of_the_kept_figures():
    lines = table({"csv": 3.0, "pipeline": 0.5}, {"csv": 4.0}, "1.2.3").splitlines()
    (csv,) = (line for line in lines if line.startswith(f"| {ROWS['csv'].name} "))
    assert csv == f"| {ROWS['csv'].name} | 3 | 4 | 0.75 | less |"
    (pipeline,) = (line for line in lines if line.startswith(f"| {ROWS['pipeline'].name} "))
    assert pipeline.endswith("| 0.5 | not measured | - | less |")
    kept = json.loads(FIGURES.read_text())
    assert set(kept["now"]) | set(kept["release"]) <= set(ROWS)
    assert DOCUMENT.read_text() == table(kept["now"], kept["release"], kept["version"])
