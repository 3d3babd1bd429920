"""Folders beside `app` in the checkout, which the wheel holds inside the package."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent


def shipped_folder(installed: str, source: str) -> Path:
    """Return a folder of the wheel (a name in the package) or of the checkout (a path from its root)."""
    folder = PACKAGE / installed
    return folder if folder.is_dir() else PACKAGE.parent / source
