"""Photographs are sent as the camera wrote them: HEIC or JPEG, with the EXIF from which the focal length is read."""

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed

HEIC, JPEG = "image/heic", "image/jpeg"


def check_exif(conversation: Conversation) -> Verdict:
    """Advise against other formats, and against photographs without EXIF, for which the phone must be calibrated."""
    photographs = [
        photograph for exchange in conversation.exchanges for photograph in exchange.photographs
    ]
    for photograph in photographs:
        if photograph.media_type not in {HEIC, JPEG}:
            return failed(
                f"{photograph.slot} is {photograph.media_type or 'no photograph'}: send the camera's own file."
            )
        if not photograph.has_exif:
            return failed(
                f"{photograph.slot} has no EXIF: the focal length is then known from a calibration only."
            )
    return (
        passed(f"{len(photographs)} photographs as a camera writes them.")
        if photographs
        else not_seen("Send a meal.")
    )
