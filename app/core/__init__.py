"""What every part of the program needs: settings, errors, units, logging.

Nothing here knows any domain. What only some domains share belongs to the lowest of them.
"""
