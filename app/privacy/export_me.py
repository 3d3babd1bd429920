"""Export all data on a participant for themselves: one ZIP with data.json, their photographs and README.txt.

It is written meal by meal, in bounded memory, to an unnamed file in the store's staging folder,
which is removed when it is closed. Secrets (hashes of tokens and codes) and internal names of rows
and blobs are left out.
"""

import base64
import json
import tempfile
import uuid
import zipfile
from collections.abc import Iterable, Iterator
from datetime import UTC, date, datetime
from typing import IO

from sqlalchemy.orm import Session

from app.db.base import Base
from app.db.session import Database
from app.foods.models import Food
from app.meals.stored.models import Meal, MealImage
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.models import Participant, Study
from app.people.participants import withdrawn_error
from app.privacy import queries as privacy
from app.storage.blob_store import BlobMissingError, BlobStore

OMITTED_COLUMNS = frozenset(
    {"token_sha256", "code_sha256", "blob_key", "result_key", "study_id", "participant_id"}
)
EXTENSIONS = {
    "image/jpeg": "jpg",
    "image/png": "png",
    "image/heic": "heic",
    "image/webp": "webp",
    "image/tiff": "tif",
    "audio/webm": "webm",
    "audio/mp4": "m4a",
}
README = """\
This is all that the study's server holds on you, made on {when}.

data.json     you (as the study knows you: by a code), your phones, days and meals. Of each meal: when and where it was
              sent from as far as the study keeps that, its photographs (length and SHA-256), what was found in them,
              which foods it was taken for and why, what you and the study's staff said about it (events), and the
              records that came of it. Masses are in grams, volumes in millilitres, times in UTC. "looks" are figures
              of colour, texture and shape of a food (base64 of little-endian 16-bit floating-point numbers), by which
              foods are known again; "known_to_the_index" are those that the study's index has learned from.
photographs/  your photographs as they are kept, a folder a meal. "file" in data.json names each; it is null where the
              photograph was erased.

Who looked at your photographs, and who changed what, stands in the study's audit log: ask the study for it.
Your data may be kept, anonymised or erased when you leave the study, as its protocol says: ask the study.
"""


def export_me(database: Database, blobs: BlobStore, caller: DeviceCaller) -> tuple[IO[bytes], int]:
    """Return the ZIP file, positioned at its start, and its length in bytes.

    The caller closes it. Raises GoneError.
    """
    now = datetime.now(UTC)
    file: IO[bytes] = tempfile.TemporaryFile(dir=blobs.staging_folder())  # noqa: SIM115  # the caller closes it
    try:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive, database.read() as session:
            participant = session.get(Participant, caller.participant_id)
            if participant is None:
                raise withdrawn_error()  # noqa: TRY301  # the file is closed below
            names = _write_photographs(archive, session, blobs, participant.id, now)
            with archive.open(
                _entry("data.json", now, compressed=True), "w", force_zip64=True
            ) as entry:
                for text in _data(session, participant, names, now):
                    entry.write(text.encode())
            archive.writestr(
                _entry("README.txt", now, compressed=True),
                README.format(when=now.strftime("%Y-%m-%d")),
            )
        with database.write() as session:
            audit.note(
                session,
                caller,
                "photograph.read",
                subject=caller.participant_alias,
                by="export",
                photographs=sum(name is not None for name in names.values()),
            )
        size = file.tell()
        file.seek(0)
    except BaseException:
        file.close()
        raise
    return file, size


def _write_photographs(
    archive: zipfile.ZipFile,
    session: Session,
    blobs: BlobStore,
    participant_id: uuid.UUID,
    now: datetime,
) -> dict[uuid.UUID, str | None]:
    """Write the photographs.

    Returns each photograph's name in the ZIP; None if it no longer exists.
    """
    names: dict[uuid.UUID, str | None] = {}
    for image, client_id in privacy.images_of_participant(session, participant_id):
        names[image.id] = None
        if image.erased_at is not None:
            continue
        try:
            pieces = blobs.stream(image.blob_key)
        except BlobMissingError:
            continue
        name = f"photographs/{client_id}/{image.slot}.{EXTENSIONS.get(image.media_type, 'bin')}"
        with archive.open(_entry(name, now, compressed=False), "w", force_zip64=True) as entry:
            for piece in pieces:
                entry.write(piece)
        names[image.id] = name
    return names


def _data(
    session: Session, participant: Participant, names: dict[uuid.UUID, str | None], now: datetime
) -> Iterator[str]:
    """Yield data.json in pieces, lists member by member."""
    study = session.get_one(Study, participant.study_id)
    yield '{\n"made_at": ' + _json(now)
    yield ',\n"study": ' + _json({"code": study.code, "name": study.name})
    yield ',\n"participant": ' + _json(_plain(participant))
    for name, rows in privacy.exported_rows(session, "participant", participant.id):
        yield from _list(name, (_plain(row) for row in rows))
    meals = (
        _meal(session, meal, names) for meal in privacy.stream_meals_of(session, participant.id)
    )
    yield from _list("meals", meals)
    yield "\n}\n"


def _list(name: str, members: Iterable[dict[str, object]]) -> Iterator[str]:
    yield f',\n"{name}": ['
    for number, member in enumerate(members):
        yield ("," if number else "") + "\n" + _json(member)
    yield "]"


def _meal(session: Session, meal: Meal, names: dict[uuid.UUID, str | None]) -> dict[str, object]:
    data = _plain(meal)
    for name, rows in privacy.exported_rows(session, "meal", meal.id):
        data[name] = [_plain(row) | _file_of(row, names) | _food_of(session, row) for row in rows]
    return data


def _file_of(row: Base, names: dict[uuid.UUID, str | None]) -> dict[str, object]:
    return {"file": names.get(row.id)} if isinstance(row, MealImage) else {}


def _food_of(session: Session, row: Base) -> dict[str, object]:
    """Return the food's key and name, since its internal id means nothing outside."""
    food_id = getattr(row, "food_id", None)
    food = session.get(Food, food_id) if food_id is not None else None
    return {"food": {"key": food.key, "name": food.name}} if food is not None else {}


def _plain(row: Base) -> dict[str, object]:
    """Return all columns of a row except OMITTED_COLUMNS, so that columns added later are exported too."""
    return {
        column.key: getattr(row, column.key)
        for column in row.__mapper__.column_attrs
        if column.key not in OMITTED_COLUMNS
    }


def _json(value: object) -> str:
    return json.dumps(value, default=_text, ensure_ascii=False)


def _text(value: object) -> str:
    if isinstance(value, (datetime, date)):
        return value.isoformat()
    if isinstance(value, uuid.UUID):
        return str(value)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    raise TypeError(f"no JSON for {type(value).__name__}")


def _entry(name: str, now: datetime, *, compressed: bool) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, date_time=now.timetuple()[:6])
    entry.compress_type = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    entry.external_attr = 0o600 << 16
    return entry
