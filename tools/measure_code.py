"""Print the size of the program: `python tools/measure_code.py [FOLDER]`.

Tokens without comments and docstrings, so that dense lines win nothing; files of the fullest folder; uses of `Any`.
"""

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

MOST_TOKENS, MOST_ANY, MOST_FILES = 434_000, 120, 25  # targets of the redesign by domain, decision 0026
LAYOUT = frozenset(
    {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def count_tokens(source: str) -> int:
    """Return the number of tokens that are code."""
    docstrings = {
        (node.body[0].lineno, node.body[0].col_offset)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None
    }
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return sum(token.type not in LAYOUT and token.start not in docstrings for token in tokens)


def count_any(source: str) -> int:
    """Return how often the name `Any` is used, imports apart."""
    return sum(isinstance(node, ast.Name) and node.id == "Any" for node in ast.walk(ast.parse(source)))


def main(folder: Path) -> None:
    """Print one line per package and the totals."""
    tokens: Counter[str] = Counter()
    files: Counter[Path] = Counter()
    anys = 0
    for path in sorted(folder.rglob("*.py")):
        source = path.read_text("utf-8")
        inside = path.relative_to(folder)
        tokens[inside.parts[0] if len(inside.parts) > 1 else "."] += count_tokens(source)
        files[inside.parent] += 1
        anys += count_any(source)
    for package, count in tokens.most_common():
        print(f"{count:8,} {package}")
    fullest, most = files.most_common(1)[0]
    print(
        f"{tokens.total():8,} tokens (target {MOST_TOKENS:,}) in {files.total()} files; "
        f"{anys} uses of Any (target {MOST_ANY}); {most} files in {fullest} (target {MOST_FILES})"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "app"))
