"""A process's metrics for Prometheus: instruments.py, reader.py (who may read them), server.py (for workers).

docs/monitoring.md describes each metric. Labels are routes, codes and stages, never a person, a study or a meal.
"""
