"""Small pictures of a pair's photographs that a run leaves beside its others: what a gallery shows without decoding.

Upright, corrected by the marker's colours, without metadata, as records/serve_photo.py would make them at this width;
artefacts like others: served with a note in the audit log, erased with the photographs, in backups.
"""

THUMBNAIL_PX = 320  # wide
SIDES = ("left", "right")


def thumbnail_name(slot: str) -> str:
    """The artefact of a run on the slot's pair."""
    return f"thumbnail_{slot.removeprefix('after_')}.jpg"
