"""Print the size of the program: `python tools/measure_code.py [--numbers] [FOLDER]`.

Tokens without comments and docstrings, and how many of them stand on a line of code: a dense line
wins nothing. Files, those of the fullest folder, and uses of `Any`. The last line leaves out
vision.

--numbers: the numbers written in FOLDER's code instead (default: app/vision), but for 0, 1, 2 and -1,
by folder: those in tuning.py, which says where each is from, and those elsewhere. Lines of code too.
"""

import argparse
import ast
import io
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

LAYOUT = frozenset(
    {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
VISION = "vision"
TUNING = "tuning.py"
PLAIN_NUMBERS = (0, 1, 2)  # a -1 is written as a minus before a 1


@dataclass(frozen=True, slots=True)
class Size:
    """The size of a file. lines: those with code. anys: uses of the name `Any`, imports apart."""

    package: str
    folder: Path
    tokens: int
    lines: int
    anys: int


def code_tokens(source: str) -> Iterator[tokenize.TokenInfo]:
    """Yield the tokens that are code."""
    docstrings = {
        (node.body[0].lineno, node.body[0].col_offset)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None
    }
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in LAYOUT and token.start not in docstrings:
            yield token


def size_of(path: Path, root: Path) -> Size:
    """Measure a file."""
    source = path.read_text("utf-8")
    inside = path.relative_to(root)
    tokens, lines = 0, set[int]()
    for token in code_tokens(source):
        tokens += 1
        lines.update(range(token.start[0], token.end[0] + 1))
    names = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name))
    anys = sum(node.id == "Any" for node in names)
    package = inside.parts[0] if len(inside.parts) > 1 else "."
    return Size(package, inside.parent, tokens, len(lines), anys)


def numbers_in(source: str) -> int:
    """Return how many numbers are written in code, but for 0, 1, 2 and -1."""
    constants = (
        node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant)
    )
    return sum(type(value) in (int, float) and value not in PLAIN_NUMBERS for value in constants)


def print_numbers(root: Path) -> None:
    """Print the numbers of each folder, and the totals."""
    numbers: Counter[str] = Counter()
    for path in sorted(root.rglob("*.py")):
        inside = path.relative_to(root)
        place = (
            TUNING if inside.name == TUNING else inside.parts[0] if len(inside.parts) > 1 else "."
        )
        numbers[place] += numbers_in(path.read_text("utf-8"))
    for place, count in numbers.most_common():
        print(f"{count:8,} {place}")
    sizes = [size_of(path, root) for path in sorted(root.rglob("*.py"))]
    lines = sum(size.lines for size in sizes)
    print(
        f"{numbers[TUNING]:8,} numbers in {TUNING}, {numbers.total() - numbers[TUNING]:,} elsewhere"
    )
    print(f"{lines:8,} lines of code in {len(sizes)} files")


def main() -> None:
    """Print what the command line asks for."""
    parser = argparse.ArgumentParser(description="Print the size of the program.")
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--numbers", action="store_true", help="the numbers written in the code")
    options = parser.parse_args()
    if options.numbers:
        print_numbers(options.folder or Path("app") / VISION)
    else:
        print_tokens(options.folder or Path("app"))


def print_tokens(root: Path) -> None:
    """Print one line per package, and the totals."""
    sizes = [size_of(path, root) for path in sorted(root.rglob("*.py"))]
    tokens: Counter[str] = Counter()
    for size in sizes:
        tokens[size.package] += size.tokens
    for package, count in tokens.most_common():
        print(f"{count:8,} {package}")
    folder, most = Counter(size.folder for size in sizes).most_common(1)[0]
    anys = sum(size.anys for size in sizes)
    print(f"{total(sizes)}; {anys} uses of Any; {most} files in {folder}")
    print(f"{total(size for size in sizes if size.package != VISION)} without vision")


def total(sizes: Iterable[Size]) -> str:
    """Return the sums in words."""
    measured = list(sizes)
    tokens = sum(size.tokens for size in measured)
    lines = sum(size.lines for size in measured)
    return f"{tokens:8,} tokens in {len(measured)} files, {tokens / max(1, lines):.1f} a line"


if __name__ == "__main__":
    main()
