"""Small pictures of a pair's photographs among a run's artefacts, so that a gallery need not decode photographs.

They are upright, colour-corrected by the marker and without metadata, like those of records/serve_photo.py at this
width. Like other artefacts they are served with an entry in the audit log, erased with the photographs, and backed up.
"""

THUMBNAIL_PX = 320  # width


def thumbnail_name(slot: str) -> str:
    """Return the artefact's name in a run on the slot's pair."""
    return f"thumbnail_{slot.removeprefix('after_')}.jpg"
