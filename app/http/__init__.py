"""HTTP as all routes speak it: problem documents, cursors, limits, ranges, request log, the connection itself.

Routes are in the domains' `api.py`; who may call them is in people/access.
"""
