"""Files that anybody may read, such as scripts, styles and pictures of pages."""

import os

from starlette.staticfiles import StaticFiles


class PublicFiles(StaticFiles):
    """Starlette's static files without names that begin with a dot."""

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """As StaticFiles; "." is the folder itself."""
        if any(part.startswith(".") and part != "." for part in path.split("/")):
            return "", None
        return super().lookup_path(path)
