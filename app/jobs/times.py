"""A worker's intervals and limits of time, in one value, so that tests can shorten them."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WorkerTimes:
    """All in seconds.

    heartbeat: between two heartbeats, and between two looks for dead workers. lease: a worker that misses heartbeats
    for so long (three of them) is dead. first_wait: before the first retry after a fault; it grows up to
    longest_wait. wait_for_room: before the first retry of an estimate that was killed or took too long; it
    quadruples with each retry. drain: for running jobs to end when the worker stops; later ones are handed back.
    """

    heartbeat: float = 2.0
    lease: float = 6.0
    first_wait: float = 0.5
    longest_wait: float = 30.0
    wait_for_room: float = 15.0
    drain: float = 5.0
