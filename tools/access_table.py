"""The lists in docs/access.md, made from the access rules: `python -m tools.access_table` writes them anew."""

import textwrap
from collections import defaultdict
from pathlib import Path

from app.core.settings import Settings
from app.main import create_app
from app.people.access.access_rules import Rule

PAGE = Path(__file__).parents[1] / "docs" / "access.md"
START, END = (
    "<!-- made from the access rules -->\n",
    "<!-- end of what is made -->\n",
)
WIDTH = 160
NO_BREAK = "\N{NO-BREAK SPACE}"  # between a method and its path


def access_lists() -> str:
    """Return Markdown: for each kind of caller the calls that they may make."""
    calls: defaultdict[str, dict[str, list[str]]] = defaultdict(dict)
    rules = create_app(Settings()).state.rules
    for (method, path), rule in sorted(rules.items(), key=lambda entry: entry[0][::-1]):
        if not rule.page:
            calls[_callers(rule)].setdefault(path, []).append(method)
    paragraphs = [_paragraph(callers, paths) for callers, paths in sorted(calls.items())]
    return "\n" + "\n".join(paragraphs) + "\n"


def page_with_lists(page: str) -> str:
    """Return the page with its lists made anew."""
    before, rest = page.split(START)
    return before + START + access_lists() + END + rest.split(END)[1]


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


def _paragraph(callers: str, paths: dict[str, list[str]]) -> str:
    """Return one item of the list: the callers, and their calls with the methods of a path together."""
    calls = [f"`{','.join(methods)}{NO_BREAK}{path}`" for path, methods in paths.items()]
    text = f"- **{callers}**: {', '.join(calls)}"
    wrapped = textwrap.fill(
        text, WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
    return wrapped.replace(NO_BREAK, " ")


if __name__ == "__main__":
    PAGE.write_text(page_with_lists(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
