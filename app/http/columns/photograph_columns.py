"""The columns of the image manifest: a row a photograph."""

from app.http.columns.column import Column
from app.http.columns.record_columns import (
    CAPTURED_AT,
    CAPTURED_LOCAL,
    LOCAL_DATE,
    MEAL_ID,
    PARTICIPANT,
    STUDY,
)
from app.photos.slots import SLOTS

PHOTOGRAPH_COLUMNS = (
    MEAL_ID,
    STUDY,
    PARTICIPANT,
    CAPTURED_AT,
    CAPTURED_LOCAL,
    LOCAL_DATE,
    Column(
        "slot",
        "word",
        meaning="Which of the meal's photographs or depth maps it is, or its voice note.",
        values=SLOTS,
    ),
    Column("media_type", "word", meaning="Of the bytes as they are kept."),
    Column("width_px", "integer", "px", "Of the upright picture; 0: a voice note."),
    Column("height_px", "integer", "px", "Of the upright picture; 0: a voice note."),
    Column("bytes", "integer", "B", "Length as it is kept."),
    Column("received_sha256", "word", meaning="SHA-256 of the bytes that the phone sent."),
    Column(
        "stored_sha256",
        "word",
        meaning="SHA-256 of the bytes that are kept: others where the location was cut out.",
    ),
    Column("received_at", "instant", meaning="When it arrived at the server."),
    Column("erased", "boolean", meaning="Whether the picture was erased (retention, withdrawal)."),
    Column("erased_at", "instant", meaning="When it was erased.", empty="It is there."),
    Column(
        "path",
        "word",
        meaning="Path of the picture, re-encoded as JPEG (docs/limits.md), or of a map or voice note as kept.",
        empty="It was erased.",
    ),
)
