"""An enrolment code as a QR code: what a phone's app reads, as SVG or PNG.

The text is JSON and no link: a link that opens an app can be caught by another app, and lands in histories and logs.
"""

import io
import json

import segno

SCALE = 8  # pixels a module of the PNG: some 400 pixels a side, sharp on a screen
ERROR_LEVEL = "m"  # 15 % may be hidden: fingers, glare, a fold


def enrolment_text(server: str, code: str) -> str:
    """What the QR code says: {"tada": 1, "server": "https://...", "code": "..."}; tada: the version of this text."""
    return json.dumps({"tada": 1, "server": server, "code": code}, separators=(",", ":"), ensure_ascii=False)


def qr_svg(text: str) -> str:
    """The QR code as SVG, to stand in a page: as large as its place there, with its quiet zone."""
    drawn = io.BytesIO()
    _qr(text).save(drawn, kind="svg", omitsize=True, xmldecl=False, light="#fff")
    return drawn.getvalue().decode()


def qr_png(text: str) -> bytes:
    """The QR code as PNG, black on white with its quiet zone."""
    drawn = io.BytesIO()
    _qr(text).save(drawn, kind="png", scale=SCALE)
    return drawn.getvalue()


def _qr(text: str) -> segno.QRCode:
    return segno.make_qr(text, error=ERROR_LEVEL, boost_error=False)
