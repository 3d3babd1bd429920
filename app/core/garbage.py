"""Settings of Python's garbage collector for processes that make pages and files of many rows."""

import gc

# a batch of an export has fewer; Python's 700 cost an export a tenth of its time
OBJECTS_PER_COLLECTION = 50_000


def collect_rarely() -> None:
    """Take all objects loaded by now as permanent, and search the newer ones less often.

    What has no cycle, as rows have none, is freed at once anyway. Collecting the permanent ones repeatedly would delay
    requests by 0.1 s.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(OBJECTS_PER_COLLECTION)
