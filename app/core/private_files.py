"""What this program writes is nobody else's to read: photographs, names, keys. Called first in each process."""

import os

OTHERS = 0o077  # what the group and everybody else may do


def keep_files_private() -> None:
    """New files are 0600 and new folders 0700, whatever the shell that started us says."""
    os.umask(OTHERS)
