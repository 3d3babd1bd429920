"""Measure kept photographs again by today's pipeline: choose pairs, feed them to idle workers, stop, continue, compare.

What a new run means for the meal's records is decided in records (match_items.py) and written with
the estimate (save_estimate.py).
"""
