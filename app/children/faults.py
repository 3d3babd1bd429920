"""Faults of a job: passing (retry), interrupted (retry alone), lasting (fail the meal), and the end of its worker.

`is_passing(error)` classifies what a use case raised. A use case raises `JobFailure` if a retry is useless, and
`BrokenOff` if a few retries with the machine to itself may help.
"""

import errno

import sqlalchemy as sa

from app.children.child_pool import ChildStartError
from app.core.errors import Failure, TadaError

PASSING_ERRNOS = frozenset(
    {
        errno.EAGAIN,
        errno.ECONNABORTED,
        errno.ECONNREFUSED,
        errno.ECONNRESET,
        errno.EDQUOT,
        errno.EHOSTUNREACH,
        errno.EIO,
        errno.EMFILE,
        errno.ENETUNREACH,
        errno.ENFILE,
        errno.ENOMEM,
        errno.ENOSPC,
        errno.EPIPE,
        errno.EROFS,
        errno.ESTALE,
        errno.ETIMEDOUT,
    }
)  # a disk, a mount or a network that fails for a while; not a missing file

JOB_GAVE_UP = Failure(
    "job_gave_up",
    "The server tried several times to estimate this meal and was interrupted each time.",
    "The photographs are kept. Ask the people who run the server to look at its log and to queue the meal again.",
)
INTERNAL_ERROR = Failure(
    "internal_error",
    "The server made a mistake while it estimated this meal.",
    "The photographs are kept. Ask the people who run the server to look at its log and to queue the meal again.",
)


PHOTOGRAPH_ERASED = Failure(
    "photograph_erased",
    "The photographs of this meal were erased before it was estimated.",
    "There is nothing to do: the study keeps photographs for a limited time, or the participant has left it.",
)
CANCELLED = Failure(
    "cancelled",
    "The estimate of this meal was cancelled before it was made.",
    "The photographs are kept. A researcher of the study can have the meal estimated after all.",
)


class JobFailure(Exception):  # noqa: N818  # it carries a Failure
    """The job cannot succeed: the meal fails with this code, without a retry."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class BrokenOff(Exception):  # noqa: N818  # it carries a Failure
    """The work was killed or ran out of time: it is retried alone, and again later, before the meal fails."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class JobLeft(BaseException):
    """This worker stops, has lost its lease or put the job off; another run will take the job up.

    A BaseException, so that no use case handles it as the job's result.
    """


def is_passing(error: Exception) -> bool:
    """Whether the same call may succeed later without a change of the program."""
    if isinstance(error, TadaError):
        return error.retryable
    if isinstance(error, sa.exc.DBAPIError):
        return error.connection_invalidated or isinstance(
            error, (sa.exc.OperationalError, sa.exc.InterfaceError)
        )
    if isinstance(error, sa.exc.TimeoutError):  # no free connection in the pool
        return True
    # a worker checks at its start that children start
    if isinstance(error, (ConnectionError, TimeoutError, ChildStartError)):
        return True
    return isinstance(error, OSError) and error.errno in PASSING_ERRNOS
