"""The memory of limits, shared by the processes of one server: made before they are forked.

Anonymous shared mappings, so nothing is left behind, and a bounded number of slots, so a flood of addresses cannot fill
the memory. Keys are stored as keyed 64 bit hashes: a caller can neither choose which key it displaces nor be read from
the memory. A process may be killed at any instruction: the lock is released by the kernel, and a slot that it has
written in part makes one key's count wrong for a minute.
"""

import fcntl
import functools
import hashlib
import mmap
import secrets
import struct
import sys
import tempfile
import threading
from pathlib import Path
from types import TracebackType

WAYS = 16  # slots in which a key may lie
SETS = 625
MAX_KEYS = SETS * WAYS  # of one table: 240 kB
_SET = struct.Struct(f"{WAYS}Q{WAYS}d{WAYS}d")  # hashes (0: free), values, times when last written


class SharedLock:
    """A lock between the threads of forked processes; the kernel releases a dead one's (fcntl(2), F_SETLKW)."""

    def __init__(self) -> None:
        self._threads = threading.Lock()
        self._file, path = tempfile.mkstemp(prefix="tada-lock-")  # never closed: closing it would release the lock
        Path(path).unlink()

    def __enter__(self) -> None:
        self._threads.acquire()
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX)
        except BaseException:
            self._threads.release()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        fcntl.lockf(self._file, fcntl.LOCK_UN)
        self._threads.release()


@functools.cache
def shared_lock() -> SharedLock:
    """Return the one lock of all tables: with several, the kernel would see deadlocks that are none (EDEADLK)."""
    return SharedLock()


class KeyTable:
    """A number and a time per key, for the MAX_KEYS keys or so that were written last. Use it with `lock` held."""

    def __init__(self) -> None:
        self.lock = shared_lock()
        self._memory = mmap.mmap(-1, SETS * _SET.size)
        self._seed = secrets.token_bytes(16)

    def get(self, key: str) -> tuple[float, float] | None:
        """Return the key's value and time; None if it is not (or no longer) known."""
        digest, offset = self._place(key)
        slots = _SET.unpack_from(self._memory, offset)
        if digest not in slots[:WAYS]:
            return None
        way = slots.index(digest)
        return slots[WAYS + way], slots[2 * WAYS + way]

    def put(self, key: str, value: float, written_at: float) -> None:
        """Write the key's value; a new key in a full set displaces the one that was written longest ago."""
        digest, offset = self._place(key)
        slots = list(_SET.unpack_from(self._memory, offset))
        hashes, times = slots[:WAYS], slots[2 * WAYS :]
        for wanted in (digest, 0):
            if wanted in hashes:
                way = hashes.index(wanted)
                break
        else:
            way = times.index(min(times))
        slots[way], slots[WAYS + way], slots[2 * WAYS + way] = digest, value, written_at
        _SET.pack_into(self._memory, offset, *slots)

    def _place(self, key: str) -> tuple[int, int]:
        """Return the key's hash and where its set begins."""
        digest = _hash(self._seed, key)
        return digest, digest % SETS * _SET.size


class ActiveCounts:
    """The number of connections or requests that each address has at the moment, in all processes.

    per_process: the most of one process. Each process writes only its own slots, one per connection or request, so the
    slots of one that died can be cleared.
    """

    def __init__(self, per_process: int, processes: int = 1) -> None:
        self._lock = shared_lock()
        self._per_process, self._processes = per_process, processes
        self._memory = mmap.mmap(-1, (1 + per_process * processes) * 8)
        # the first: how many have ever been in use, so that few are searched; then the processes' slots in turn
        self._slots = memoryview(self._memory).cast("Q")
        self._seed = secrets.token_bytes(16)
        self._free: list[int] = []
        self.become(0)

    def become(self, process: int) -> None:
        """Write the slots of this process from now on, by its number from 0."""
        self._free = list(self._slots_of(process))[::-1]

    def clear(self, process: int) -> None:
        """Forget what a process had that is dead."""
        for slot in self._slots_of(process):
            self._slots[slot] = 0

    def add(self, address: str, at_most: int | None) -> int | None:
        """Count one more of an address. Return its slot, for `remove`; None if the address has `at_most` already.

        Raises IndexError if this process has its most.
        """
        digest = _hash(self._seed, address)
        with self._lock:
            if at_most is not None:
                in_use = self._memory[: 8 * self._slots[0]]
                if in_use.count(digest.to_bytes(8, sys.byteorder)) >= at_most:
                    return None
            slot = self._free.pop()
            self._slots[slot] = digest
            self._slots[0] = max(self._slots[0], slot + 1)
        return slot

    def remove(self, slot: int) -> None:
        """It has ended."""
        self._slots[slot] = 0
        self._free.append(slot)

    def total(self) -> int:
        """Return the number of all addresses in all processes."""
        return sum(slot != 0 for slot in self._slots[1:])

    def _slots_of(self, process: int) -> range:
        return range(1 + process, len(self._slots), self._processes)


def _hash(seed: bytes, key: str) -> int:
    """Return 64 bits that are never 0, which marks a free slot."""
    digest = hashlib.blake2b(key.encode("utf-8", "surrogatepass"), digest_size=8, key=seed).digest()
    return int.from_bytes(digest, "little") | 1
