"""A process's metrics for Prometheus: instruments.py, server.py (for workers; who may read them).

docs/monitoring.md describes each metric. Labels are routes, codes and stages, never a person, a
study or a meal.
"""
