"""Durable jobs: the queue in the database, its workers' lives, takeover, and the limited child processes.

jobs knows how work is claimed, tried again, handed over and given up; what the work is, services tell (job_runner.py).
"""
