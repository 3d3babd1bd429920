"""Print the size of the program: `python tools/measure_code.py [FOLDER]`.

Tokens without comments and docstrings, and how many of them stand on a line of code: a dense line
wins nothing. Files, those of the fullest folder, and uses of `Any`. The last line leaves out
vision.
"""

import ast
import io
import sys
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


def main(root: Path) -> None:
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
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "app"))
