"""Settings, errors, units and logging, used by every part of the program.

Nothing here depends on a domain. Code that only some domains share belongs to the lowest of them.
"""
