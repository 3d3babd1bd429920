"""The context of a page: request, caller, study; rendering templates, CSV files, redirecting."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated
from urllib.parse import quote, unquote

from fastapi import Depends, Request
from markupsafe import Markup
from pydantic import BaseModel
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.core.errors import NotFoundError
from app.dashboard.forms import EMPTY_FORM, FormState
from app.dashboard.templates import render
from app.db.session import Database
from app.http.file_formats import FORMATS
from app.http.flat_list import encode_flat, flat_paths
from app.http.state import ApiState
from app.people.access.caller import StaffCaller, reaches, role_in
from app.people.access.deps import CurrentStaff, State
from app.people.access.page_rules import PREFIX, is_https
from app.people.devices import qr_svg
from app.people.models import Role, Study

NOTICE_COOKIE = "tada_notice"  # one sentence for the next page: "The device was revoked."
NOTICE_SECONDS = 60


@dataclass(frozen=True, slots=True)
class Page:
    """A page that a signed-in caller requests.

    study, role: of the study in the path, if there is one.
    """

    request: Request
    state: ApiState
    caller: StaffCaller
    study: Study | None
    role: Role | None

    @property
    def is_fragment(self) -> bool:
        """Whether htmx requests a part of the page that it already shows."""
        headers = self.request.headers
        return (
            headers.get("hx-request") == "true"
            and headers.get("hx-history-restore-request") != "true"
        )

    @property
    def database(self) -> Database:
        """The process's database."""
        return self.state.database

    @property
    def study_code(self) -> str:
        """Code of the page's study. Raises NotFoundError."""
        return self.require_study().code

    @property
    def study_caller(self) -> StaffCaller:
        """The caller with access to the page's study only, not to meals of others.

        Raises NotFoundError.
        """
        study = self.require_study()
        if self.role is None:
            raise NotFoundError("There is no such study.")
        return replace(
            self.caller, is_admin=False, roles={study.id: self.role}, only_study_id=study.id
        )

    def require_study(self) -> Study:
        """Return the page's study. Raises NotFoundError if the page belongs to none."""
        if self.study is None:
            raise NotFoundError("There is no such study.")
        return self.study

    def may(self, needed: Role) -> bool:
        """Whether to show a control that needs this role in the study.

        The server checks again when it is used.
        """
        return reaches(self.role, needed)

    def render(
        self,
        template: str,
        /,
        *,
        form: FormState = EMPTY_FORM,
        status: int = 200,
        **context: object,
    ) -> HTMLResponse:
        """Render the template, which sees the page as `page`, and the form's values and errors.

        A whole page shows the notice of the last action once. status: where the form has no error.
        """
        notice = None if self.is_fragment else self.request.cookies.get(NOTICE_COOKIE)
        context = {"values": form.values, "wrong": form.wrong} | context
        answer = HTMLResponse(
            render(template, page=self, notice=unquote(notice) if notice else None, **context),
            status_code=form.status or status,
        )
        if notice:
            answer.delete_cookie(NOTICE_COOKIE, path=PREFIX)
        return answer

    def redirect(self, path: str, notice: str | None = None) -> Response:
        """Redirect to another page after an action. notice: a sentence that the page shows."""
        answer: Response
        if self.is_fragment:
            answer = Response(status_code=204, headers={"HX-Redirect": path})
        else:
            answer = RedirectResponse(path, status_code=303)
        if notice is not None:
            answer.set_cookie(
                NOTICE_COOKIE,
                quote(notice),
                max_age=NOTICE_SECONDS,
                path=PREFIX,
                secure=is_https(self.request, self.state.settings),
                httponly=True,
                samesite="lax",
            )
        return answer

    def address(self, **changes: object) -> str:
        """Return this page's address with changed parameters; None and "" remove one, a list repeats it."""
        kept = [
            (name, value)
            for name, value in self.request.query_params.multi_items()
            if name not in changes
        ]
        for name, value in changes.items():
            values = value if isinstance(value, list | tuple) else [value]
            kept += [(name, str(part)) for part in values if part is not None and part != ""]
        query = "&".join(f"{quote(name)}={quote(value, safe='')}" for name, value in kept)
        return f"{self.request.url.path}?{query}" if query else self.request.url.path


def current_page(request: Request, state: State, caller: CurrentStaff) -> Page:
    """Return the requested page; `authorise` has checked the caller's access."""
    study: Study | None = getattr(request.state, "study", None)
    return Page(
        request, state, caller, study, role_in(caller, study.id) if study is not None else None
    )


CurrentPage = Annotated[Page, Depends(current_page)]


def drawn_qr(text: str) -> Markup:
    """Draw a QR code to embed in a page."""
    return Markup(qr_svg(text))  # noqa: S704  # drawn by segno, holds no text


def csv_file(model: type[BaseModel], rows: Sequence[BaseModel], name: str) -> Response:
    """Return rows of a schema as CSV.

    name: the file's, without its extension; unsafe characters become `-`.
    """
    records = [row.model_dump(mode="json", by_alias=True) for row in rows]
    safe_name = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    return Response(
        b"".join(encode_flat("csv", flat_paths(model, records), records)),
        media_type=FORMATS["csv"].media_type,
        headers={"Content-Disposition": f'attachment; filename="{safe_name}.csv"'},
    )
