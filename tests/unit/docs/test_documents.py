"""Documents that list what the code has: they may not drift."""

import ast
import pathlib
import re

from app.core.settings import Settings
from app.meals import item_state
from app.meals.meal_time import CLOCK_DOUBTFUL

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
    for _, value, setting, *_ in (row for row in rows if len(row) == 5):
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


def codes_in_the_source():
    """Every code that the program can answer: `code` of errors, `code=` arguments, those of Failure and PairProblem."""
    codes = set()
    for path in (DOCS.parent / "app").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                named = [keyword.value for keyword in node.keywords if keyword.arg == "code"]
                is_failure = isinstance(node.func, ast.Name) and node.func.id in ("Failure", "PairProblem")
                named += node.args[:1] if is_failure else []
            elif isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == ["code"]:
                named = [node.value]
            elif isinstance(node, ast.Assign) and [ast.unparse(each) for each in node.targets] == ["CODES_BY_STATUS"]:
                named = node.value.values
            else:
                continue
            either = [part for value in named for part in branches_of(value)]
            codes |= {part.value for part in either if isinstance(part, ast.Constant) and isinstance(part.value, str)}
    return codes


def branches_of(value):
    """A value, or both of a conditional one."""
    return [value.body, value.orelse] if isinstance(value, ast.IfExp) else [value]


def test_every_code_stands_in_the_documents_and_no_other():
    listed = set(re.findall(r"^\| `([a-z_]+)` \|", (DOCS / "errors.md").read_text(), re.MULTILINE))
    assert codes_in_the_source() == listed


def test_no_code_is_told_twice():
    rows = re.findall(r"^\| `([a-z_]+)` \|", (DOCS / "errors.md").read_text(), re.MULTILINE)
    assert sorted(rows) == sorted(set(rows))


def flags_in_the_source():
    """Every flag that an item can carry: what is assigned or given to `flags`, appended to it, or returned by it."""
    flags = set()
    for path in (DOCS.parent / "app" / "vision").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == ["flags"]:
                value = node.value
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == "flags.append":
                value = node.args[0]
            elif isinstance(node, ast.keyword) and node.arg == "flags":
                value = node.value
            elif isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "SCALE_FLAGS":
                value = ast.Module(node.value.values, [])
            elif isinstance(node, ast.FunctionDef) and node.name == "flags":
                value = ast.Module(node.body[1:], [])  # without its docstring
            else:
                continue
            words = [each.value for each in ast.walk(value) if isinstance(each, ast.Constant)]
            flags |= {word for word in words if isinstance(word, str)}
    return flags


def flags_of_foods():
    """What an item can carry because of its food: named where the item's state is."""
    return {value for name, value in vars(item_state).items() if name.startswith("FOOD_")}


def test_every_flag_stands_in_the_documents_and_no_other():
    listed = set(re.findall(r"^\| `([a-z_]+)` \|", (DOCS / "flags.md").read_text(), re.MULTILINE))
    assert flags_in_the_source() | flags_of_foods() | {CLOCK_DOUBTFUL} == listed


def test_every_folder_of_the_program_stands_in_the_layout_once():
    table = (DOCS / "development.md").read_text().partition("## Code layout")[2].partition("In a domain's folder")[0]
    listed = [
        name
        for cell in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE)
        for name in re.findall(r"`([a-z_.]+)`", cell)
    ]
    folders = {path.parent.name for path in (DOCS.parent / "app").glob("*/__init__.py")}
    assert sorted(name for name in listed if not name.endswith(".py")) == sorted(folders - {"demo_data"})


def test_every_decision_has_a_number_of_its_own_and_says_it():
    files = sorted((DOCS / "decisions").glob("[0-9]*.md"))
    numbers = [path.name[:4] for path in files]
    assert len(set(numbers)) == len(numbers)
    for number, path in zip(numbers, files, strict=True):
        assert path.read_text(encoding="utf-8").startswith(f"# {number}: "), path.name
