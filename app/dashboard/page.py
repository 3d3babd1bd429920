"""What every page asks for: who looks, at which study, and how a template becomes an answer."""

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import quote, unquote

from fastapi import Depends, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.dashboard.templates import render
from app.http.state import ApiState
from app.people.access.caller import StaffCaller, reaches, role_in
from app.people.access.deps import CurrentStaff, State
from app.people.access.page_rules import PREFIX, is_https
from app.people.models import Role, Study

TOLD_COOKIE = "tada_told"  # one sentence for the next page: "The device was revoked."
TOLD_SECONDS = 60


@dataclass(frozen=True, slots=True)
class Page:
    """A page that is asked for by somebody who is signed in. study, role: of the study in the path, if there is one."""

    request: Request
    state: ApiState
    caller: StaffCaller
    study: Study | None
    role: Role | None

    @property
    def is_fragment(self) -> bool:
        """Whether htmx asks for a part of the page that it shows already."""
        headers = self.request.headers
        return headers.get("hx-request") == "true" and headers.get("hx-history-restore-request") != "true"

    def may(self, needed: Role) -> bool:
        """Whether a control that needs this role in the study is shown. The server asks again when it is used."""
        return reaches(self.role, needed)

    def render(self, template: str, /, *, status: int = 200, **context: object) -> HTMLResponse:
        """The template as the answer. It sees the page as `page`."""
        told = self.request.cookies.get(TOLD_COOKIE)
        shown = None if self.is_fragment else told
        answer = HTMLResponse(
            render(template, page=self, told=unquote(shown) if shown else None, **context), status_code=status
        )
        if shown:
            answer.delete_cookie(TOLD_COOKIE, path=PREFIX)
        return answer

    def go(self, path: str, told: str | None = None) -> Response:
        """To another page, after something was done; told: a sentence that it shows."""
        answer: Response
        if self.is_fragment:
            answer = Response(status_code=204, headers={"HX-Redirect": path})
        else:
            answer = RedirectResponse(path, status_code=303)
        if told is not None:
            answer.set_cookie(
                TOLD_COOKIE,
                quote(told),
                max_age=TOLD_SECONDS,
                path=PREFIX,
                secure=is_https(self.request, self.state.settings),
                httponly=True,
                samesite="lax",
            )
        return answer

    def address(self, **changes: object) -> str:
        """This page's address with other parameters; None and "" take one out, a list gives one several times."""
        kept = [(name, value) for name, value in self.request.query_params.multi_items() if name not in changes]
        for name, value in changes.items():
            values = value if isinstance(value, list | tuple) else [value]
            kept += [(name, str(one)) for one in values if one is not None and one != ""]
        query = "&".join(f"{quote(name)}={quote(value, safe='')}" for name, value in kept)
        return f"{self.request.url.path}?{query}" if query else self.request.url.path


def current_page(request: Request, state: State, caller: CurrentStaff) -> Page:
    """The page that is asked for; `authorise` has let the caller in."""
    study: Study | None = getattr(request.state, "study", None)
    return Page(request, state, caller, study, role_in(caller, study.id) if study is not None else None)


CurrentPage = Annotated[Page, Depends(current_page)]
