"""Durable jobs: the queue in the database, workers and their leases, claims, retries, takeovers, sweeps.

The work itself, and the worker that does it, belong to meals/estimate.
"""
