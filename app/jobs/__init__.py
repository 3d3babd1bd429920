"""Durable jobs: the queue in the database, workers and their leases, claims, retries, takeovers, sweeps.

The work itself belongs to estimates, whose use cases job_runner.py gets injected.
"""
