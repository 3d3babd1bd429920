"""Mutants: small changes of a file, each of which still compiles."""

from tools.mutations import mutations

SOURCE = '''"""Words."""

LIMIT: int = 3


def share(part: float, whole: float, rows: list[int]) -> float | None:
    """Return the share."""
    if part < 0 or (whole) == 0:
        raise ValueError("no share")
    rows.append(1)
    return part / whole if True else None
'''


def changes():
    source = SOURCE.encode()
    return {(each.rule, source[each.start : each.end].decode(), each.replacement.strip()) for each in mutations(source)}


def test_operators_constants_conditions_and_statements_are_changed_and_types_and_words_are_not():
    assert changes() == {
        ("constant", "3", "4"),
        ("condition", "part < 0 or (whole) == 0", "(not (part < 0 or (whole) == 0))"),
        ("operator", " < ", "<="),
        ("constant", "0", "1"),
        ("operator", " or ", "and"),
        ("operator", ") == ", ")  !="),
        ("statement", 'raise ValueError("no share")', "pass"),
        ("statement", "rows.append(1)", "pass"),
        ("constant", "1", "2"),
        ("statement", "return part / whole if True else None", "return None"),
        ("operator", " / ", "*"),
        ("condition", "True", "(not (True))"),
        ("constant", "True", "False"),
    }
