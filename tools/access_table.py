"""The table in docs/access.md, made from CALLS: `python -m tools.access_table` writes it anew."""

from collections import defaultdict
from pathlib import Path

from app.people.access.access_rules import CALLS, Rule

PAGE = Path(__file__).parents[1] / "docs" / "access.md"
START, END = "<!-- table from app/people/access/access_rules.py -->\n", "<!-- end of the table -->\n"
CHANGING = ("POST", "PUT", "PATCH", "DELETE")


def access_table() -> str:
    """Return Markdown: one row per path, with who may read it and who may change it."""
    by_path: defaultdict[str, dict[str, Rule]] = defaultdict(dict)
    for call, rule in CALLS.items():
        method, path = call.split()
        by_path[path][method] = rule
    lines = [_row("path", "`GET`", "changes"), _row("---", "---", "---")]
    for path, rules in sorted(by_path.items()):
        reading = _callers(rules["GET"]) if "GET" in rules else ""
        changing = [method for method in CHANGING if method in rules]
        changes = [f"`{method}` {_callers(rules[method])}" for method in changing]
        lines.append(_row(f"`{path}`", reading, "; ".join(changes)))
    return "".join(lines)


def page_with_table(page: str) -> str:
    """Return the page with its table made anew."""
    before, rest = page.split(START)
    return before + START + access_table() + END + rest.split(END)[1]


def _callers(rule: Rule) -> str:
    """Return who may call: a phone, and the least role."""
    if rule.is_open:
        return "anybody"
    if rule.scraper:
        return "scraper"
    staff = "signed in" if rule.session else rule.staff
    callers = ["phone"] if rule.device else []
    if staff is not None:
        callers.append("staff" if staff == "any" else staff)
    return ", ".join(callers)


def _row(*cells: str) -> str:
    return "|" + "".join(f" {cell} |" if cell else " |" for cell in cells) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page_with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
