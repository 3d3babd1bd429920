"""What a release's own release.json tells of it: protocol, versions of the pipeline, food tables."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import JsonValue, TypeAdapter

from app.releases.queries import NamedRelease
from app.releases.release_files import MANIFEST
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore


@dataclass(frozen=True, slots=True)
class ReleaseContents:
    """program: the version that froze it. protocol: the study's, at that moment. placed_meals: whose place it holds.

    pipeline_versions, methods, food_tables: the number of items of each.
    """

    program: str
    pipeline_versions: Mapping[str, int]
    methods: Mapping[str, int]
    food_tables: Mapping[str, int]
    foods: int
    placed_meals: int
    protocol: Mapping[str, JsonValue]


CONTENTS = TypeAdapter(ReleaseContents)


def read_contents(blobs: BlobStore, found: NamedRelease) -> ReleaseContents | None:
    """From the file itself; None: the release is not ready, or its file is not what was frozen (its check tells).

    Raises OSError of a store that is away.
    """
    key = next((file.blob_key for file in found.files if file.name == MANIFEST), None)
    if key is None or found.release.state != "ready":
        return None
    try:
        manifest = json.loads(b"".join(blobs.stream(key)))
        return CONTENTS.validate_python({**manifest, **manifest["contents"]})
    except (BlobMissingError, BlobDamagedError, ValueError):
        return None
