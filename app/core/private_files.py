"""Keep files that the program writes private: photographs, names, keys. Called first in each process."""

import os

OTHERS = 0o077  # permissions of group and others


def keep_files_private() -> None:
    """Create files as 0600 and folders as 0700, whatever umask the process inherited."""
    os.umask(OTHERS)
