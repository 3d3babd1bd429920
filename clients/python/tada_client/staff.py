"""The calls of a study's staff: participants and codes, records, files, changes."""

import hashlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import cast

from tada_client import schemas
from tada_client.caller import Caller, Filter, path_of
from tada_client.errors import NetworkError

POLL_SECONDS = 2.0
UNFINISHED = frozenset({"queued", "running"})


class Staff(Caller):
    """A staff member, by a token of `POST /v1/tokens` or `tada admin create`.

    filters are the query parameters of the call, such as study="pilot"; `from` is written `**{"from": "2026-11-01"}`.
    """

    def create_study(self, study: schemas.StudyIn) -> schemas.StudyOut:
        """Create a study."""
        return cast(schemas.StudyOut, self.call("POST", "/v1/studies", json=study))

    def create_participant(
        self, study: str, participant: schemas.ParticipantIn
    ) -> schemas.ParticipantOut:
        """Create a participant."""
        path = path_of("studies", study, "participants")
        return cast(schemas.ParticipantOut, self.call("POST", path, json=participant))

    def create_enrolment_code(self, study: str, participant: str) -> schemas.EnrolmentCodeOut:
        """Create a one-time code for a phone of the participant."""
        path = path_of("studies", study, "participants", participant, "enrolment-codes")
        return cast(schemas.EnrolmentCodeOut, self.call("POST", path))

    def list_records(self, **filters: Filter) -> Iterator[schemas.RecordOut]:
        """Yield records in the order of capture, page by page."""
        yield from self.rows("/v1/records", filters)

    def list_meals(self, **filters: Filter) -> Iterator[schemas.MealListItem]:
        """Yield meals by time of capture, page by page."""
        yield from self.rows("/v1/meals", filters)

    def list_photographs(self, study: str, **filters: Filter) -> Iterator[schemas.PhotographOut]:
        """Yield the study's photographs, page by page."""
        yield from self.rows(path_of("studies", study, "photographs"), filters)

    def list_changes(self, study: str, since: str | None = None) -> Iterator[schemas.ChangePage]:
        """Yield pages of what changed or was erased, until there is no more for now.

        Keep the last page's `next`, and pass it as `since` the next time.
        """
        path = since or path_of("studies", study, "changes")
        while True:
            page: schemas.ChangePage = self.call("GET", path)
            yield page
            if not page["has_more"]:
                return
            path = page["next"]

    def download_records(self, target: Path, file_format: str = "csv", **filters: Filter) -> Path:
        """Save all records of one moment as one file: csv, ndjson, parquet or geojson."""
        return self.download("/v1/records", target, query={"format": file_format, **filters})

    def export(self, study: str, request: schemas.ExportIn, target: Path) -> schemas.ExportOut:
        """Have a file of any size made, wait for it and save it; a broken download continues where it broke off.

        Raises Problem 409 `export_failed` or `export_cancelled` if it was not made, and NetworkError if the saved bytes
        are not those that were made.
        """
        made: schemas.ExportOut = self.call(
            "POST", path_of("studies", study, "exports"), json=request
        )
        path = path_of("studies", study, "exports", made["id"])
        while made["state"] in UNFINISHED:
            time.sleep(POLL_SECONDS)
            made = self.call("GET", path)
        self.download(f"{path}/file", target)
        with target.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() != made["sha256"]:
                target.unlink()
                raise NetworkError("The saved file is not the one that was made.")
        return made
