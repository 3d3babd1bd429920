"""The page that a newcomer reads first: every file and function that it names is there, and they stay few."""

import ast
import pathlib
import re

ROOT = pathlib.Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
MOST_FILES = 15


def steps():
    """(file, what is said of it) of the numbered steps of one meal."""
    way = PAGE.partition("## The way of one meal")[2].partition("\n## ")[0]
    return re.findall(r"^\d+\. `(app/[\w/]+\.py)`: (.*(?:\n    .*)*)", way, re.MULTILINE)


def names_in(path):
    tree = ast.parse((ROOT / path).read_text())
    return {node.name for node in ast.walk(tree) if hasattr(node, "name")}


def test_way_of_one_meal_is_short_and_names_only_files_and_functions_that_are_there():
    files = [path for path, _ in steps()]
    assert 10 <= len(files) == len(set(files)) <= MOST_FILES
    assert (files[0], files[-1]) == ("app/uploads/api.py", "app/exports/lists/records_api.py")
    for path, words in steps():
        named = re.findall(r"`(\w+)`", words)
        assert named, path
        assert set(named) <= names_in(path), path
    paths = re.findall(r"`(app/[\w/.]+)`", PAGE)
    assert len(paths) > MOST_FILES
    assert [path for path in paths if not (ROOT / path).exists()] == []
