"""Which food an item may be: the learned index, ranked candidates, what a study has confirmed.

The mathematics, which knows no database, is in identification.
"""
