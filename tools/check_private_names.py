"""Fail where the program uses names that another package keeps to itself: `python tools/check_private_names.py`.

Such a name begins with an underscore, in an import (`from h11._readers import ...`) or behind a full stop. ruff reports
the latter (SLF001), so what is looked for here is who told ruff to be quiet.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

OWN = ("app", "__future__")
SILENCED = "noqa: SLF001"


def private_imports(source: str) -> Iterator[tuple[int, str]]:
    """Yield (line, name) of each import of another package's private module or name."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None and not node.level:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            package, *parts = name.split(".")
            if package not in OWN and any(part.startswith("_") for part in (package, *parts)):
                yield node.lineno, name


def silenced(source: str) -> Iterator[tuple[int, str]]:
    """Yield (line, text) where access to a private member is allowed by a comment."""
    for number, line in enumerate(source.splitlines(), 1):
        if SILENCED in line:
            yield number, line.strip()


def main(folder: Path) -> int:
    """Print what there is; return how many."""
    count = 0
    for path in sorted(folder.rglob("*.py")):
        source = path.read_text("utf-8")
        for number, words in sorted([*private_imports(source), *silenced(source)]):
            print(f"{path}:{number}: private to another package: {words}")
            count += 1
    return count


if __name__ == "__main__":
    sys.exit(1 if main(Path("app")) else 0)
