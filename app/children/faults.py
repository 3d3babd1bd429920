"""Kinds of trouble: one that passes (try again), one that may (try alone), one that lasts, and the worker's own end.

`is_passing(error)` sorts what a use case raised; `JobFailure` is how a use case says that trying again is useless,
`BrokenOff` that it is worth a few more tries with the machine to itself.
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
)  # a disk, a mount or a network that is out of order for a while; a file that is not there is none of them

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
    """A use case's word that the job cannot succeed: the meal fails with this code, without another try."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class BrokenOff(Exception):  # noqa: N818  # it carries a Failure
    """The work was ended from outside or ran out of time: it is tried again alone, and later, before the meal fails."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class JobLeft(BaseException):
    """This worker lets go of a job and leaves it as it is: it stops, or has lost its lease.

    No Exception, so that no use case takes it for the job's result: another worker takes the job over.
    """


def is_passing(error: Exception) -> bool:
    """Whether the same call may succeed later without anybody changing the program."""
    if isinstance(error, TadaError):
        return error.retryable
    if isinstance(error, sa.exc.DBAPIError):
        return error.connection_invalidated or isinstance(error, (sa.exc.OperationalError, sa.exc.InterfaceError))
    if isinstance(error, sa.exc.TimeoutError):  # no free connection in the pool
        return True
    if isinstance(error, (ConnectionError, TimeoutError, ChildStartError)):  # a worker starts only if children do
        return True
    return isinstance(error, OSError) and error.errno in PASSING_ERRNOS
