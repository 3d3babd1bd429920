"""Cells of CSV files that are safe to open in a spreadsheet."""

# a spreadsheet would compute such a cell; the last four are full-width, as Chinese and Japanese
# keyboards type them
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def safe_cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula, with an apostrophe; a list in one cell."""
    if isinstance(value, list | tuple):
        value = " ".join(map(str, value))
    if isinstance(value, str) and value.startswith(FORMULA_STARTS):
        return f"'{value}"
    return value
