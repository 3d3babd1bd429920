"""How long a worker waits for what; one value, so that tests can live faster."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WorkerTimes:
    """All in seconds.

    heartbeat: between two heartbeats, and between two looks for dead workers. lease: a worker without a heartbeat for
    so long is dead (three are missing). first_wait doubles with each try after a fault up to longest_wait.
    wait_for_room: before an estimate that was killed or took too long is tried again, four times as long with each try.
    drain: what running jobs get to end once the worker was asked to; a job that needs longer is handed back.
    """

    heartbeat: float = 2.0
    lease: float = 6.0
    first_wait: float = 0.5
    longest_wait: float = 30.0
    wait_for_room: float = 15.0
    drain: float = 5.0
