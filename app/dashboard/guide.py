"""/docs/guide: the pages of docs/ with a search, for everybody who can reach the server.

Pages are rendered from the Markdown that the wheel holds, or the checkout. Links between them stay; one to a file that
is not in docs/ becomes plain text, since a server does not have it.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from posixpath import normpath
from urllib.parse import parse_qs

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup
from starlette.responses import HTMLResponse, Response
from starlette.types import Scope

from app.core.shipped import shipped_folder
from app.dashboard.answers import HEADERS
from app.dashboard.templates import render
from app.http.public_files import PublicFiles

PATH = "/docs/guide"
FIRST = ("research", "operations", "apps", "capture", "development")  # what each kind of reader begins with
LONGEST_QUERY = 200
MOST_HITS, SNIPPET = 30, 160


@dataclass(frozen=True, slots=True)
class Section:
    """A heading with the plain text below it. anchor: "" before the first heading."""

    anchor: str
    heading: str
    text: str


@dataclass(frozen=True, slots=True)
class GuidePage:
    """A page. name: its path in docs/ without .md. question: its first sentence. links: (page, anchor) in docs/."""

    name: str
    title: str
    question: str
    html: Markup
    sections: tuple[Section, ...]
    links: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Hit:
    """A section in which all words of a search occur."""

    page: GuidePage
    section: Section
    snippet: str


class GuideFiles(PublicFiles):
    """ASGI app for PATH: pages, the list of them with the search, and the pictures that they show."""

    def __init__(self) -> None:
        super().__init__(directory=guide_folder())

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a page, the list, or a file of docs/."""
        if path == ".":
            query = parse_qs(scope["query_string"].decode("latin-1")).get("q", [""])[0][:LONGEST_QUERY]
            answer: Response = _answer("guide_list.html", query=query, hits=search(query))
        elif path in guide_pages():
            answer = _answer("guide_page.html", guide_page=guide_pages()[path])
        else:
            answer = await super().get_response(path, scope)
        answer.headers.update(HEADERS)
        return answer


def _answer(template: str, **context: object) -> HTMLResponse:
    return HTMLResponse(render(template, guide=PATH, pages=listed_pages(), **context))


def guide_folder() -> Path:
    """Return docs/: of the wheel, or of the checkout."""
    return shipped_folder("_docs", "docs")


@cache
def guide_pages() -> Mapping[str, GuidePage]:
    """Return name -> page."""
    folder = guide_folder()
    names = [path.relative_to(folder).with_suffix("").as_posix() for path in sorted(folder.rglob("*.md"))]
    return {name: _page(name, (folder / f"{name}.md").read_text()) for name in names}


def listed_pages() -> list[GuidePage]:
    """Return the pages, those that readers begin with first, without the decisions."""
    pages = guide_pages()
    rest = [page for name, page in pages.items() if "/" not in name and name not in FIRST]
    return [*(pages[name] for name in FIRST), *sorted(rest, key=lambda page: page.title)]


def search(query: str) -> list[Hit]:
    """Return the sections that have all words of a query, those with the words in their headings first."""
    words = query.lower().split()
    if not words:
        return []
    hits = [
        (sum(word in heading for word in words), sum(text.count(word) for word in words), page, section)
        for page in guide_pages().values()
        for section in page.sections
        for heading, text in ((f"{page.title} {section.heading}".lower(), section.text.lower()),)
        if all(word in heading or word in text for word in words)
    ]
    hits.sort(key=lambda hit: hit[:2], reverse=True)
    return [Hit(page, section, _snippet(section.text, words)) for _, _, page, section in hits[:MOST_HITS]]


def _snippet(text: str, words: Sequence[str]) -> str:
    place = max(min((at for word in words if (at := text.lower().find(word)) >= 0), default=0) - SNIPPET // 4, 0)
    return text[place : place + SNIPPET]


def _page(name: str, text: str) -> GuidePage:
    parser = MarkdownIt("commonmark").enable("table")
    tokens = parser.parse(text)
    links = [link for token in _inner(tokens) if (link := _set_address(token, name)) is not None]
    sections = list(_sections(tokens))
    first = next(place for place, token in enumerate(tokens) if token.type == "paragraph_open")
    return GuidePage(
        name=name,
        title=sections[0].heading,
        question=re.split(r"(?<=[.?:])\s", _text_of(tokens[first + 1]))[0],
        html=Markup(parser.renderer.render(tokens, parser.options, {})),  # noqa: S704 - these pages are the program's
        sections=tuple(sections),
        links=tuple(links),
    )


def _sections(tokens: Sequence[Token]) -> Iterator[Section]:
    """Give each heading its anchor, by GitHub's rule; return the headings with what stands below them."""
    anchor = heading = ""
    below: list[str] = []
    for place, token in enumerate(tokens):
        if token.type == "heading_open":
            if heading:
                yield Section(anchor, heading, " ".join(below))
            heading, below = _text_of(tokens[place + 1]), []
            anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
            token.attrSet("id", anchor)
        elif token.type in ("th_open", "td_open"):
            token.attrs.pop("style", None)  # the pages' policy allows none
        elif token.type in ("inline", "fence", "code_block") and tokens[place - 1].type != "heading_open":
            below.append(_text_of(token))
    yield Section(anchor, heading, " ".join(below))


def _text_of(token: Token) -> str:
    if token.children is None:
        return token.content
    shown = (child for child in token.children if child.type != "image")
    return "".join(" " if child.type == "softbreak" else child.content for child in shown)


def _inner(tokens: Sequence[Token]) -> Iterator[Token]:
    for token in tokens:
        yield from token.children or ()


def _set_address(token: Token, name: str) -> tuple[str, str] | None:
    """Turn a link between files into one between pages. Return its page and anchor; None if it leads elsewhere."""
    attribute = {"link_open": "href", "image": "src"}.get(token.type)
    if attribute is None or re.match(r"[a-z]+:", target := str(token.attrGet(attribute))):
        return None
    file, _, anchor = target.partition("#")
    path = normpath(f"{name}/../{file}") if file else f"{name}.md"
    if path.startswith(".."):
        token.attrs.clear()  # a link without an address is plain text
        return None
    page = path.removesuffix(".md")
    token.attrSet(attribute, f"{PATH}/{page}" + (f"#{anchor}" if anchor else ""))
    return page, anchor
