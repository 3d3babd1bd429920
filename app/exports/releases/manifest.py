"""The manifest of a release, datapackage.json: a Data Package (Frictionless Data) with our facts.

The checksum of a release is the SHA-256 over the sorted lines `sha256  name` of its files, as
sha256sum writes them, without the manifest, which has the person and time: the same data frozen
twice have the same checksum.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pydantic import BaseModel, JsonValue, TypeAdapter

from app.exports.releases.queries import ReleaseRow
from app.exports.releases.tables import FORMER_MANIFEST, KEYS, MANIFEST
from app.http.columns.dictionary import Column, table_schema
from app.http.file_formats import FORMATS, Output
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore

FACTS = "tada"  # the member of datapackage.json that is ours
PROFILE = "https://datapackage.org/profiles/2.0/datapackage.json"


@dataclass(frozen=True, slots=True)
class MadeFile:
    """A file of a release. rows: None if it is no table. key: where it is in the store."""

    name: str
    rows: int | None
    bytes: int
    sha256: str
    key: str


class Protocol(BaseModel):
    """The part of the study's protocol that a removal of erased data needs."""

    expects_after_pair: bool


class FormerChecksum(BaseModel):
    """The checksum that a release had until erased data were removed from it."""

    checksum: str
    until: str


class Manifest(BaseModel):
    """The facts that a removal of erased data reads. tables: name -> columns from left to right."""

    protocol: Protocol
    tables: dict[str, tuple[Column, ...]]
    checksum: str
    altered: list[FormerChecksum]


@dataclass(frozen=True, slots=True)
class ReleaseContents:
    """What a release is made of.

    program: the version that froze it.
    pipeline_versions, methods, food_tables: number of items of each.
    placed_meals: meals with a place.
    protocol: the study's at that moment.
    """

    program: str
    pipeline_versions: Mapping[str, int]
    methods: Mapping[str, int]
    food_tables: Mapping[str, int]
    foods: int
    placed_meals: int
    protocol: Mapping[str, JsonValue]


CONTENTS = TypeAdapter(ReleaseContents)


def facts_of(text: bytes) -> dict[str, Any]:
    """Our facts of a manifest, of this version's or of release.json. Raises ValueError."""
    values: dict[str, Any] = json.loads(text)
    facts: dict[str, Any] = values.get(FACTS, values)
    return facts


def read_contents(blobs: BlobStore, row: ReleaseRow) -> ReleaseContents | None:
    """Read the manifest; None if the release is not ready, or the file is damaged or missing.

    Raises OSError if the store is unavailable.
    """
    names = (MANIFEST, FORMER_MANIFEST)
    key = next((file.blob_key for file in row.files if file.name in names), None)
    if key is None or row.release.state != "ready":
        return None
    try:
        facts = facts_of(b"".join(blobs.stream(key)))
        return CONTENTS.validate_python({**facts, **facts["contents"]})
    except (BlobMissingError, BlobDamagedError, ValueError):
        return None


def manifest_text(
    facts: Mapping[str, JsonValue],
    tables: Mapping[str, Sequence[Column]],
    files: Sequence[MadeFile],
) -> bytes:
    """datapackage.json: a resource a file, and the facts with the tables' columns and the checksum."""
    package = {
        "$schema": PROFILE,
        "name": f"{facts['study']}-{facts['name']}".lower(),
        "created": facts["frozen_at"],
        "resources": [_resource(file, tables) for file in files],
        FACTS: {
            **facts,
            "tables": {
                name: [asdict(column) for column in columns] for name, columns in tables.items()
            },
            "checksum": checksum_of({file.name: file.sha256 for file in files}),
        },
    }
    return json.dumps(package, indent=1, ensure_ascii=False).encode() + b"\n"


def checksum_of(sha256s: Mapping[str, str]) -> str:
    """Return the checksum of a release. sha256s: by file name."""
    manifests = (MANIFEST, FORMER_MANIFEST)
    lines = sorted(
        f"{sha256}  {name}\n" for name, sha256 in sha256s.items() if name not in manifests
    )
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _resource(file: MadeFile, tables: Mapping[str, Sequence[Column]]) -> dict[str, JsonValue]:
    stem, _, kind = file.name.rpartition(".")
    output: Output = "parquet" if kind == "parquet" else "csv"
    resource: dict[str, JsonValue] = {
        "name": stem if output == "parquet" else f"{stem}-csv",
        "path": file.name,
        "format": output,
        "mediatype": FORMATS[output].content_type,
        "bytes": file.bytes,
        "hash": f"sha256:{file.sha256}",
    }
    if stem in tables:
        resource["rows"] = file.rows
        resource["schema"] = table_schema(tables[stem], key=KEYS.get(stem, ()))
    return resource
