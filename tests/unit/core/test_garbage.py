import subprocess
import sys


def test_rows_without_cycles_cause_no_collection():
    """In a process of its own: the settings are a process's."""
    program = """
import gc
from app.core.process_life import collect_rarely
collect_rarely()
before = [generation["collections"] for generation in gc.get_stats()]
rows = [[(number, float(number)), [number]] for number in range(10_000)]
assert [generation["collections"] for generation in gc.get_stats()] == before
assert gc.isenabled() and gc.get_freeze_count() > 1000
"""
    subprocess.run([sys.executable, "-c", program], check=True)
