"""Public documentation: /docs, the OpenAPI document in Swagger UI, and /docs/guide, the pages of docs/.

Pages are rendered from the Markdown that the wheel holds, or the checkout. Links between them stay;
one to a file that is not in docs/ becomes plain text, since a server does not have it. Nothing is
requested of other hosts.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from posixpath import normpath
from urllib.parse import parse_qs

from markdown_it import MarkdownIt
from markupsafe import Markup
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.types import Scope

from app.core.shipped import shipped_folder
from app.dashboard.answers import HEADERS
from app.dashboard.templates import render
from app.http.ranges import PublicFiles

PATH = "/docs/guide"
# what each kind of reader begins with
FIRST = ("research", "operations", "apps", "capture", "development")
LONGEST_QUERY = 200
MOST_HITS, SNIPPET = 30, 160
LINK = re.compile(r"\[([^\]]*)\]\((?![a-z]+:)([^)#\s]*)(#[^)\s]*)?\)")
HEADING = re.compile(r"<h(\d)>(.*?)</h\1>")
SECTION = re.compile(r'<h\d id="(.*?)">(.*?)</h\d>')
REFERENCE_PATH = "/docs"


@dataclass(frozen=True, slots=True)
class Section:
    """A heading with the plain text below it."""

    page: str
    anchor: str
    heading: str
    text: str

    def snippet(self, words: list[str]) -> str:
        """Return the text around the first of the words."""
        place = min((at for word in words if (at := self.text.lower().find(word)) >= 0), default=0)
        return self.text[max(place - SNIPPET // 4, 0) :][:SNIPPET]


@dataclass(frozen=True, slots=True)
class GuidePage:
    """A page.

    name: its path in docs/ without .md. question: its first sentence. links: (page or file,
    anchor).
    """

    name: str
    title: str
    question: str
    html: Markup
    sections: tuple[Section, ...]
    links: tuple[tuple[str, str], ...]


class GuideFiles(PublicFiles):
    """ASGI app for PATH: pages, the list of them with the search, and the pictures that they show."""

    def __init__(self) -> None:
        super().__init__(directory=guide_folder())

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a page, the list, or a file of docs/."""
        html = await run_in_threadpool(_page_at, path, scope["query_string"].decode("latin-1"))
        answer: Response = (
            HTMLResponse(html) if html is not None else await super().get_response(path, scope)
        )
        answer.headers.update(HEADERS)
        return answer


def _page_at(path: str, query_string: str) -> str | None:
    """Return a page, or the list with what was searched for; None for other files."""
    pages = guide_pages()
    if path in pages:
        return render("guide_page.html", guide=PATH, pages=listed_pages(), guide_page=pages[path])
    if path != ".":
        return None
    query = parse_qs(query_string).get("q", [""])[0][:LONGEST_QUERY]
    words = query.lower().split()
    return render(
        "guide_list.html",
        guide=PATH,
        pages=listed_pages(),
        query=query,
        words=words,
        hits=search(words),
    )


def guide_folder() -> Path:
    """Return docs/: of the wheel, or of the checkout."""
    return shipped_folder("_docs", "docs")


@cache
def guide_pages() -> Mapping[str, GuidePage]:
    """Return name -> page."""
    folder = guide_folder()
    names = [
        path.relative_to(folder).with_suffix("").as_posix() for path in sorted(folder.rglob("*.md"))
    ]
    return {name: _page(name, (folder / f"{name}.md").read_text()) for name in names}


def listed_pages() -> list[GuidePage]:
    """Return the pages, those that readers begin with first, without the decisions."""
    pages = guide_pages()
    rest = [page for name, page in pages.items() if "/" not in name and name not in FIRST]
    return [*(pages[name] for name in FIRST), *sorted(rest, key=lambda page: page.title)]


def search(words: list[str]) -> list[Section]:
    """Return the sections that have all of these words, in small letters; those with them in their headings first."""
    hits = [
        (sum(word in heading for word in words), sum(text.count(word) for word in words), section)
        for page in guide_pages().values()
        for section in page.sections
        for heading, text in ((f"{page.title} {section.heading}".lower(), section.text.lower()),)
        if words and all(word in heading or word in text for word in words)
    ]
    return [hit[2] for hit in sorted(hits, key=lambda hit: hit[:2], reverse=True)[:MOST_HITS]]


def _page(name: str, text: str) -> GuidePage:
    links: list[tuple[str, str]] = []

    def address(link: re.Match[str]) -> str:
        shown, file, anchor = link[1], link[2], link[3] or ""
        path = normpath(f"{name}/../{file}") if file else name
        if path.startswith(".."):
            return shown
        links.append((path.removesuffix(".md"), anchor[1:]))
        return f"[{shown}]({PATH}/{path.removesuffix('.md')}{anchor})"

    html = MarkdownIt("commonmark").enable("table").render(LINK.sub(address, text))
    html = HEADING.sub(
        lambda found: f'<h{found[1]} id="{_anchor(found[2])}">{found[2]}</h{found[1]}>', html
    )
    parts = [Markup(part).striptags() for part in SECTION.split(html)]  # noqa: S704 - the program's own pages
    sections = [Section(name, *parts[place : place + 3]) for place in range(1, len(parts), 3)]
    return GuidePage(
        name=name,
        title=sections[0].heading,
        question=re.split(r"(?<=[.?:])\s", sections[0].text)[0],
        html=Markup(html),  # noqa: S704
        sections=tuple(sections),
        links=tuple(links),
    )


def _anchor(heading: str) -> str:
    """Return a heading's anchor by GitHub's rule."""
    return re.sub(r"[^\w\- ]", "", Markup(heading).striptags().lower()).replace(" ", "-")  # noqa: S704


async def api_reference(_request: Request) -> HTMLResponse:
    """Return the page. It is public, as the document is."""
    return HTMLResponse(
        render("api_reference.html"), headers=dict(HEADERS) | {"Cache-Control": "no-cache"}
    )
