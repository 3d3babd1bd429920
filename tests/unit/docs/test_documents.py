"""Documents that list what the code has: they may not drift."""

import ast
import pathlib
import re

import pytest

from app.core.settings import Settings
from app.meals.stored import item_state
from app.meals.stored.meal_time import CLOCK_DOUBTFUL
from app.meals.stored.models import REENCODED
from app.records.meal_schemas import HintIn, NewMealMetadataIn

DOCS = pathlib.Path(__file__).parents[3] / "docs"


def test_every_setting_stands_in_the_documents_with_its_default_and_words():
    text = (DOCS / "settings.md").read_text()
    rows = [line for line in text.splitlines() if line.startswith("| `TADA_")]
    assert len(rows) == len(Settings.model_fields)
    for name, field in Settings.model_fields.items():
        default = "" if field.default is None else f"`{field.default}`"
        assert f"| `TADA_{name.upper()}` | {default} | {field.description} |" in rows


LIMIT_NAMES = re.compile(r"max_|min_|_per_minute|_seconds|_bytes|_concurrency|_children|pool")


def test_limits_stand_on_their_page_with_the_values_of_their_settings():
    rows = [line.split(" | ") for line in (DOCS / "limits.md").read_text().splitlines() if line.startswith("| ")]
    told = {}
    for _, value, setting, *_ in (row for row in rows if len(row) == 4):
        for name in re.findall(r"`TADA_([A-Z_]+)`", setting):
            told.setdefault(name.lower(), value)
    assert set(told) == {name for name in Settings.model_fields if LIMIT_NAMES.search(name)}
    for name, value in told.items():
        default = Settings.model_fields[name].default
        assert "see [" in value or number_in(value) == default, (name, value, default)


def number_in(value):
    """The figure of a table's cell: 1,000; 30 MiB; 60 million; 10 s."""
    amount, *unit = value.split()
    scale = {"KiB": 2**10, "MiB": 2**20, "GiB": 2**30, "million": 10**6, "s": 1}
    return float(amount.replace(",", "")) * scale[unit[0] if unit else "s"]


def target_of(node):
    """The name that a node assigns to; None if it is no such node."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return targets[0].id if len(targets) == 1 and isinstance(targets[0], ast.Name) else None


def words_in(values):
    """The texts that stand anywhere in these values."""
    parts = [each.value for value in values for each in ast.walk(value) if isinstance(each, ast.Constant)]
    return {word for word in parts if isinstance(word, str)}


def nodes_of(folder, word):
    """The nodes of all files that have this word."""
    for path in folder.rglob("*.py"):
        text = path.read_text()
        if re.search(word, text):
            yield from ast.walk(ast.parse(text))


def codes_in_the_source():
    """Every code that the program can answer: `code` of errors, `code=` arguments, those of Failure and PairProblem."""
    codes = set()
    for node in nodes_of(DOCS.parent / "app", r"\bcode\b|CODES_BY_STATUS|Failure|PairProblem"):
        if isinstance(node, ast.Call):
            named = [keyword.value for keyword in node.keywords if keyword.arg == "code"]
            is_failure = isinstance(node.func, ast.Name) and node.func.id in ("Failure", "PairProblem")
            named += node.args[:1] if is_failure else []
        elif isinstance(node, ast.Assign) and target_of(node) == "code":
            named = [node.value]
        elif isinstance(node, ast.Assign) and target_of(node) == "CODES_BY_STATUS":
            named = node.value.values
        else:
            continue
        either = [[value.body, value.orelse] if isinstance(value, ast.IfExp) else [value] for value in named]
        codes |= words_in(part for parts in either for part in parts if isinstance(part, ast.Constant))
    return codes


def flags_in_the_source():
    """Every flag that an item can carry: what is assigned or given to `flags`, appended to it, or returned by it."""
    flags = set()
    for node in nodes_of(DOCS.parent / "app" / "vision", r"flags|SCALE_FLAGS"):
        if isinstance(node, ast.Assign) and target_of(node) == "flags":
            flags |= words_in([node.value])
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "flags.append":
            flags |= words_in(node.args[:1])
        elif isinstance(node, ast.keyword) and node.arg == "flags":
            flags |= words_in([node.value])
        elif isinstance(node, ast.AnnAssign) and target_of(node) == "SCALE_FLAGS":
            flags |= words_in(node.value.values)
        elif isinstance(node, ast.FunctionDef) and node.name == "flags":
            flags |= words_in(node.body[1:])  # without its docstring
    return flags


def test_every_code_stands_in_the_documents_once_and_no_other():
    rows = re.findall(r"^\| `([a-z_]+)` \|", (DOCS / "errors.md").read_text(), re.MULTILINE)
    assert sorted(codes_in_the_source()) == sorted(rows)


def test_every_flag_stands_in_the_documents_and_no_other():
    of_foods = {value for name, value in vars(item_state).items() if name.startswith("FOOD_")}
    listed = set(re.findall(r"^\| `([a-z_]+)` \|", (DOCS / "flags.md").read_text(), re.MULTILINE))
    of_records = {
        CLOCK_DOUBTFUL,
        REENCODED,
        item_state.IMPLAUSIBLE_AMOUNT,
        item_state.SCALE_DOUBTFUL,
        item_state.COPIED,
    }
    assert flags_in_the_source() | of_foods | of_records == listed


@pytest.mark.parametrize(
    ("model", "heading"), [(NewMealMetadataIn, "| field | needed |"), (HintIn, "| field | meaning |")]
)
def test_page_for_apps_has_every_field_that_a_phone_may_send(model, heading):
    text = (DOCS / "apps.md").read_text()
    table = text[text.index(heading) :].split("\n\n")[0]
    named = re.findall(r"^\| `(\w+)`", table, re.MULTILINE)
    assert sorted(named) == sorted(model.model_fields)
