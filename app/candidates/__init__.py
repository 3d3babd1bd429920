"""Rank the foods that an item may be: the learned index, candidates, a study's confirmed items.

The mathematics, without a database, is in identification.
"""
