"""/v1/studies/{study}/exports: files of a study's rows, made in the background and downloaded when they are done."""

from fastapi import APIRouter, Request, Response

from app.exports import background_exports
from app.exports.export_files import FILES, stored_file_responses
from app.exports.export_spec import spec_of_json
from app.exports.queries import RequestedExport
from app.exports.schemas import ExportIn, ExportList, ExportOut
from app.http.paging import Cursor, Limit
from app.http.parameters import ExportId, StudyCode
from app.http.problems import problem_responses
from app.http.ranges import answer_stored_file
from app.http.row_filter import WIRE_NAMES
from app.people.access.deps import CurrentStaff, State

router = APIRouter(
    prefix="/v1/studies/{study}/exports",
    tags=["exports"],
    responses=problem_responses(401, 403, 404, 422),
)


@router.post(
    "",
    status_code=202,
    responses={
        200: {
            "model": ExportOut,
            "description": "The same export was requested before and is not finished yet.",
        },
        **problem_responses(429),
    },
)
def post_export(
    study: StudyCode, body: ExportIn, state: State, caller: CurrentStaff, response: Response
) -> ExportOut:
    """Request a file of any size, which a worker makes from one snapshot. Poll `Location` until its state is done."""
    row, is_new = background_exports.request_export(state.database, caller, study, body.as_spec())
    response.headers["Location"] = f"/v1/studies/{study}/exports/{row.export.id}"
    if not is_new:
        response.status_code = 200
    return _out(study, row)


@router.get("")
def get_exports(
    request: Request,
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> ExportList:
    """The study's exports of all staff members, the newest first."""
    page = background_exports.list_exports(
        state.database, caller, study, cursor=cursor, limit=limit
    )
    return ExportList.of(request, page, lambda row: _out(study, row))


@router.get("/{export_id}")
def get_export(
    study: StudyCode, export_id: ExportId, state: State, caller: CurrentStaff
) -> ExportOut:
    """An export and its progress."""
    return _out(study, background_exports.read_export(state.database, caller, study, export_id))


@router.get(
    "/{export_id}/file",
    response_class=Response,
    responses=stored_file_responses(FILES) | problem_responses(409, 410, 416, 503),
)
def get_export_file(
    request: Request, study: StudyCode, export_id: ExportId, state: State, caller: CurrentStaff
) -> Response:
    """An export's file. Interrupted downloads resume with `Range` and `If-Range`; the ETag is the file's SHA-256."""
    file = background_exports.open_export(state.database, caller, study, export_id)
    return answer_stored_file(request, state.blobs, file)


@router.delete("/{export_id}", status_code=204)
def delete_export(
    study: StudyCode, export_id: ExportId, state: State, caller: CurrentStaff
) -> Response:
    """Cancel an unfinished export, or remove a finished one with its file: your own, or as an owner any."""
    background_exports.remove_export(state.database, caller, study, export_id)
    return Response(status_code=204)


def _out(study: str, row: RequestedExport) -> ExportOut:
    export, spec = row.export, spec_of_json(row.export.spec)
    path = f"/v1/studies/{study}/exports/{export.id}/file"
    return ExportOut(
        rows=spec.rows,
        layout=spec.layout,
        format=spec.output,
        components=spec.components,
        provenance=spec.provenance,
        filters={
            WIRE_NAMES[name]: value
            for name, value in export.spec["filters"].items()
            if name != "study_code"
        },
        asked_by=row.requested_by,
        change_seq=export.at_change_seq,
        failure=export.failure_code,
        file=path if export.state == "done" else None,
        **{
            name: getattr(export, name)
            for name in (
                *(
                    "id",
                    "state",
                    "requested_at",
                    "started_at",
                    "finished_at",
                    "rows_written",
                    "rows_estimated",
                ),
                *("bytes", "sha256", "expires_at"),
            )
        },
    )
