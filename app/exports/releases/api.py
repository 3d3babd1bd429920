"""/v1/studies/{study}/releases: a study's data frozen under a name, with checksums; downloaded file by file."""

from typing import Annotated, cast

from fastapi import APIRouter, Path, Request, Response

from app.exports.export_files import FILES, stored_file_responses
from app.exports.release_models import ReleaseState
from app.exports.releases import releases
from app.exports.releases.queries import ReleaseRow
from app.exports.releases.schemas import (
    CheckedFileOut,
    FormerChecksum,
    ReleaseCheckOut,
    ReleaseFileOut,
    ReleaseIn,
    ReleaseList,
    ReleaseOut,
)
from app.http.paging import Cursor, Limit
from app.http.parameters import ReleaseName, StudyCode
from app.http.problems import problem_responses
from app.http.ranges import answer_stored_file
from app.people.access.deps import CurrentStaff, State

router = APIRouter(
    prefix="/v1/studies/{study}/releases",
    tags=["releases"],
    responses=problem_responses(401, 403, 404, 422),
)

RELEASE_FILES = FILES | {"application/json": {"schema": {"type": "object"}}}


@router.post("", status_code=202, responses=problem_responses(409))
def post_release(
    study: StudyCode, body: ReleaseIn, state: State, caller: CurrentStaff, response: Response
) -> ReleaseOut:
    """Request a release of the study's current data, which a worker makes. Poll `Location` until it is ready."""
    row = releases.request_release(
        state.database, caller, study, name=body.name, note=body.note, filters=body.as_filters()
    )
    response.headers["Location"] = f"/v1/studies/{study}/releases/{body.name}"
    return _out(study, row)


@router.get("")
def get_releases(
    request: Request,
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> ReleaseList:
    """The study's releases, the newest first."""
    page = releases.list_releases(state.database, caller, study, cursor=cursor, limit=limit)
    return ReleaseList.of(request, page, lambda row: _out(study, row))


@router.get("/{name}")
def get_release(
    study: StudyCode, name: ReleaseName, state: State, caller: CurrentStaff
) -> ReleaseOut:
    """A release with its files."""
    return _out(study, releases.read_release(state.database, caller, study, name))


@router.get(
    "/{name}/files/{file}",
    response_class=Response,
    responses=stored_file_responses(RELEASE_FILES) | problem_responses(409, 416, 503),
)
def get_release_file(
    request: Request,
    study: StudyCode,
    name: ReleaseName,
    file: Annotated[
        str, Path(max_length=64, description="The file's name, as the release lists it.")
    ],
    state: State,
    caller: CurrentStaff,
) -> Response:
    """A file of a release; the ETag is its SHA-256."""
    stored_file = releases.open_release_file(state.database, caller, study, name, file)
    return answer_stored_file(request, state.blobs, stored_file)


@router.get("/{name}/check", responses=problem_responses(409, 503))
def get_release_check(
    study: StudyCode, name: ReleaseName, state: State, caller: CurrentStaff
) -> ReleaseCheckOut:
    """Read all files back and compare them with what was frozen; the time grows with the release's size."""
    check = releases.check_release(state.database, state.blobs, caller, study, name)
    return ReleaseCheckOut(
        is_whole=check.is_whole,
        checksum=check.checksum,
        files=[
            CheckedFileOut(name=file.name, sha256=file.sha256, found=file.state)
            for file in check.files
        ],
    )


def _out(study: str, row: ReleaseRow) -> ReleaseOut:
    release = row.release
    path = f"/v1/studies/{study}/releases/{release.name}/files"
    return ReleaseOut(
        name=release.name,
        note=release.note,
        state=cast("ReleaseState", release.state),
        filters=release.filters,
        made_by=row.requested_by,
        requested_at=release.requested_at,
        frozen_at=release.frozen_at,
        change_seq=release.at_change_seq,
        checksum=release.checksum,
        altered_at=release.altered_at,
        former_checksums=[
            FormerChecksum(checksum=former, until=until)
            for former, until in release.former_checksums
        ],
        rows=release.rows_written,
        bytes=release.bytes,
        failure=release.failure_code,
        files=[
            ReleaseFileOut(
                name=file.name,
                rows=file.rows,
                bytes=file.bytes,
                sha256=file.sha256,
                path=f"{path}/{file.name}",
            )
            for file in row.files
            if release.state == "ready"
        ],
    )
