"""The effective record of each item: projected from runs and events, stored, read, rebuilt, recomputed.

What people say of a meal is in records/review, measuring kept photographs again in
records/remeasurements. Lists and files of records belong to exports.
"""
