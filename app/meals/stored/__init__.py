"""The rows of a meal: photographs, jobs, runs, items, records and review events; sealing photographs; the meal's time.

Use cases belong to meals/upload (phones), meals/estimate (workers) and records (projection and
review).
"""
