"""The rows of a meal: photographs, jobs, runs, items, records and review events; sealing photographs; the meal's time.

What is done with them belongs to uploads (phones), estimates (workers), records (projection and review).
"""
