"""The failures of a photograph's file, in words for a person; each format's reader fills in what it met."""

from app.core.errors import Failure

SEND_AGAIN = "Send the file again, byte for byte as the camera saved it."


def truncated(what: str) -> Failure:
    """The file ends before `what`."""
    return Failure("image_truncated", f"The file ends too early: {what}.", SEND_AGAIN)


def unreadable(what: str) -> Failure:
    """The file's structure is broken, or has more parts than any camera writes."""
    return Failure("image_unreadable", f"The file is damaged: {what}.", SEND_AGAIN)
