"""The table in docs/access.md, made from RULES: `python -m tools.access_table` writes it anew."""

from pathlib import Path

from app.people.access.access_rules import RULES, SAFE_METHODS, Rule
from app.people.access.page_rules import OPEN_PAGES, PAGES

PAGE = Path(__file__).parents[1] / "docs" / "access.md"
START, END = "<!-- table from app/people/access/access_rules.py -->\n", "<!-- end of the table -->\n"
PAGES_START, PAGES_END = "<!-- table from app/people/access/page_rules.py -->\n", "<!-- end of the pages -->\n"
HEADINGS = ("call", "anybody", "phone", "viewer", "reviewer", "owner", "admin", "read-only token")
LEAST = {"any": 0, "viewer": 1, "reviewer": 2, "owner": 3, "admin": 4}


def access_table() -> str:
    """Markdown: a row a route, a column a role."""
    lines = [_row(HEADINGS), _row(["---"] * len(HEADINGS))]
    lines += [
        _row([f"`{method} {path}`", *_cells(method, rule)])
        for (method, path), rule in sorted(RULES.items(), key=lambda entry: (entry[0][1], entry[0][0]))
        if not rule.page
    ]
    return "".join(lines)


def page_table() -> str:
    """Markdown: a row a page of the dashboard, and the call whose rule it has."""
    rows = {**dict.fromkeys(OPEN_PAGES, "anybody"), **{page: f"`{' '.join(call)}`" for page, call in PAGES.items()}}
    lines = [_row(["page", "as"]), _row(["---", "---"])]
    lines += [
        _row([f"`{method} {path}`", rows[method, path]]) for method, path in sorted(rows, key=lambda at: at[::-1])
    ]
    return "".join(lines)


def page_with_table(page: str) -> str:
    """The page with its table made anew."""
    for start, table, end in ((START, access_table(), END), (PAGES_START, page_table(), PAGES_END)):
        before, rest = page.split(start)
        page = before + start + table + end + rest.split(end)[1]
    return page


def _cells(method: str, rule: Rule) -> list[str]:
    if rule.is_open:
        return ["yes"] * (len(HEADINGS) - 1)
    if rule.scraper:
        return ["with `TADA_METRICS_TOKEN`, or from the same machine", *[""] * (len(HEADINGS) - 2)]
    staff = [rule.staff is not None and LEAST[rule.staff] <= LEAST[role] for role in ("viewer", "reviewer", "owner")]
    staff.append(rule.staff is not None)
    yes = "signed in" if rule.session else "yes"
    reads = rule.staff is not None and method in SAFE_METHODS and not rule.session
    return ["", "yes" if rule.device else "", *[yes if may else "" for may in staff], "yes" if reads else ""]


def _row(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    PAGE.write_text(page_with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
