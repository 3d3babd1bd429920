"""The contents of a release by its release.json: protocol, versions of the pipeline, food tables."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import JsonValue, TypeAdapter

from app.releases.queries import ReleaseRow
from app.releases.release_files import MANIFEST
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore


@dataclass(frozen=True, slots=True)
class ReleaseContents:
    """program: version that froze it. protocol: the study's at that moment. placed_meals: meals with a place.

    pipeline_versions, methods, food_tables: number of items of each.
    """

    program: str
    pipeline_versions: Mapping[str, int]
    methods: Mapping[str, int]
    food_tables: Mapping[str, int]
    foods: int
    placed_meals: int
    protocol: Mapping[str, JsonValue]


CONTENTS = TypeAdapter(ReleaseContents)


def read_contents(blobs: BlobStore, row: ReleaseRow) -> ReleaseContents | None:
    """Read release.json; None if the release is not ready, or the file is damaged or missing.

    Raises OSError if the store is unavailable.
    """
    key = next((file.blob_key for file in row.files if file.name == MANIFEST), None)
    if key is None or row.release.state != "ready":
        return None
    try:
        manifest = json.loads(b"".join(blobs.stream(key)))
        return CONTENTS.validate_python({**manifest, **manifest["contents"]})
    except (BlobMissingError, BlobDamagedError, ValueError):
        return None
