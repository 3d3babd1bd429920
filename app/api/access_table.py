"""The table in docs/access.md, made from RULES: `python -m app.api.access_table` writes it anew."""

from pathlib import Path

from app.api.access import RULES, SAFE_METHODS, Rule

PAGE = Path(__file__).parents[2] / "docs" / "access.md"
START, END = "<!-- table from app/api/access.py -->\n", "<!-- end of the table -->\n"
HEADINGS = ("call", "anybody", "phone", "viewer", "reviewer", "owner", "admin", "read-only token")
LEAST = {"any": 0, "viewer": 1, "reviewer": 2, "owner": 3, "admin": 4}


def access_table() -> str:
    """Markdown: a row a route, a column a role."""
    lines = [_row(HEADINGS), _row(["---"] * len(HEADINGS))]
    lines += [
        _row([f"`{method} {path}`", *_cells(method, rule)])
        for (method, path), rule in sorted(RULES.items(), key=lambda entry: (entry[0][1], entry[0][0]))
    ]
    return "".join(lines)


def page_with_table(page: str) -> str:
    """The page with its table made anew."""
    before, rest = page.split(START)
    return before + START + access_table() + END + rest.split(END)[1]


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
