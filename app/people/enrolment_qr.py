"""An enrolment code as a QR code, as SVG or PNG: for the study's app, or for the browser of any phone.

For an app the text is JSON, not a link: another app can intercept a link, and links end up in histories and logs.
For a browser it is a link to the capture page. The code stands after the #, which no browser sends to a server, and the
page removes it from the address at once.
"""

import io
import json

import segno

SCALE = 8  # pixels per module of the PNG: about 400 pixels per side, sharp on a screen
ERROR_LEVEL = "m"  # up to 15 % may be covered: fingers, glare, a fold


def enrolment_text(server: str, code: str) -> str:
    """Return the QR code's text: {"tada": 1, "server": "https://...", "code": "..."}; tada: version of the format."""
    return json.dumps(
        {"tada": 1, "server": server, "code": code}, separators=(",", ":"), ensure_ascii=False
    )


def capture_link(server: str, code: str) -> str:
    """Return the link by which the capture page enrols a phone's browser."""
    return f"{server}/capture/#code={code}"


def qr_svg(text: str) -> str:
    """Draw a QR code as SVG to embed in a page, without a size of its own, with its quiet zone."""
    buffer = io.BytesIO()
    _qr(text).save(buffer, kind="svg", omitsize=True, xmldecl=False, light="#fff")
    return buffer.getvalue().decode()


def qr_png(text: str) -> bytes:
    """Draw a QR code as PNG, black on white with its quiet zone."""
    buffer = io.BytesIO()
    _qr(text).save(buffer, kind="png", scale=SCALE)
    return buffer.getvalue()


def _qr(text: str) -> segno.QRCode:
    return segno.make_qr(text, error=ERROR_LEVEL, boost_error=False)
