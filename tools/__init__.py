"""What maintainers run from a checkout: builders of the data that ships, checks of packages and of the program's size.

Commands are `python -m tools...`. app/ imports nothing from here.
"""
