"""What a process counts of itself, for Prometheus; instruments.py, reader.py: who may read it, server.py: a worker's.

docs/monitoring.md tells each of them. Labels are routes, codes and stages: never a person, a study or a meal.
"""
