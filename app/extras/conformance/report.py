"""A report of verdicts, as JSON and as a page that renews itself."""

from collections.abc import Sequence
from importlib import resources

from jinja2 import Environment
from starlette.responses import HTMLResponse, JSONResponse
from starlette.types import Receive, Scope, Send

from app.extras.conformance.app_checks import judge
from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Result, is_conforming

PAGE, JSON = "/conformance", "/conformance.json"
PATHS = frozenset({PAGE, JSON})
WORDS = {"passed": "passed", "failed": "failed", "not_seen": "not seen yet"}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}
Report = list[dict[str, object]]


def app_report(conversations: Sequence[Conversation]) -> Report:
    """Return the verdicts on each phone."""
    return [
        report_of(
            conversation.device_name, judge(conversation), requests=len(conversation.exchanges)
        )
        for conversation in conversations
    ]


def report_of(name: str, results: list[Result], **facts: object) -> dict[str, object]:
    """Return the verdicts on one phone or server as JSON. facts: more about it."""
    return {
        "name": name,
        **facts,
        "conforming": is_conforming(results),
        "checks": [
            {
                "name": result.name,
                "title": result.title,
                "outcome": result.verdict.outcome,
                "detail": result.verdict.detail,
                "required": result.is_required,
            }
            for result in results
        ],
    }


def render_page(report: Report, *, refresh_seconds: int | None = None) -> str:
    """Return the report as HTML. refresh_seconds: it renews itself so often."""
    template = resources.files(__package__).joinpath("report.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True).from_string(template)
    return page.render(report=report, words=WORDS, refresh_seconds=refresh_seconds)


async def respond(scope: Scope, receive: Receive, send: Send, report: Report) -> None:
    """Answer a call of the report's addresses."""
    if scope["path"] == JSON:
        await JSONResponse(report, headers=HEADERS)(scope, receive, send)
    else:
        await HTMLResponse(render_page(report, refresh_seconds=2), headers=HEADERS)(
            scope, receive, send
        )
