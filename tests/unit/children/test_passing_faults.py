import errno

import sqlalchemy as sa

from app.children.child_pool import ChildStartError
from app.children.faults import is_passing
from app.core.errors import ConflictError, UnavailableError

PASSING = [
    OSError(errno.ENOSPC, "full"),
    OSError(errno.EIO, "disk"),
    ConnectionResetError(),
    TimeoutError(),
    UnavailableError("later"),
    ChildStartError("killed for want of memory while it was starting"),
    sa.exc.OperationalError("SELECT 1", {}, Exception("gone")),
    sa.exc.TimeoutError(),
]
LASTING = [
    FileNotFoundError(errno.ENOENT, "no file"),
    PermissionError(errno.EACCES, "no right"),
    KeyError("a bug"),
    ConflictError("no"),
    sa.exc.IntegrityError("INSERT", {}, Exception("unique")),
]


def test_fault_that_may_go_away_is_passing_and_one_that_somebody_must_mend_is_lasting():
    assert [error for error in PASSING if not is_passing(error)] == []
    assert [error for error in LASTING if is_passing(error)] == []
