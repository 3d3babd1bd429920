"""Write clients/python/tada_client/schemas.py from the OpenAPI document: `python -m tools.client_types`.

One TypedDict for each body that the client's modules name, and for what these consist of.
"""

import keyword
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from app.core.settings import Settings
from app.main import create_app

CLIENT = Path(__file__).parents[1] / "clients" / "python" / "tada_client"
TARGET = CLIENT / "schemas.py"
REFERENCE = "#/components/schemas/"
HEADER = '''"""JSON of requests and answers, from the OpenAPI document by tools/client_types.py; /docs describes it."""

from typing import Any, Literal, NotRequired, TypedDict


'''
NAMES = {
    "string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None", "object": "dict[str, Any]"
}  # fmt: skip


def python_source() -> str:
    """Return the module's text."""
    with tempfile.TemporaryDirectory() as folder:
        schemas = create_app(Settings(data_dir=Path(folder))).openapi()["components"]["schemas"]
    sources = [path.read_text("utf-8") for path in CLIENT.glob("*.py") if path != TARGET]
    wanted = sorted(
        {name for source in sources for name in re.findall(r"\bschemas\.(\w+)", source)}
    )
    reached: dict[str, Mapping[str, Any]] = {}
    while wanted:
        name = wanted.pop()
        if name not in reached:
            reached[name] = schemas[name]
            wanted += _references(schemas[name])
    classes = [_declaration(name, schema) for name, schema in sorted(reached.items())]
    return formatted(HEADER + "\n\n\n".join(classes) + "\n")


def formatted(source: str) -> str:
    """Return a module's text as ruff formats it."""
    command = [sys.executable, "-m", "ruff", "format", "--stdin-filename", str(TARGET), "-"]
    return subprocess.run(command, input=source, capture_output=True, text=True, check=True).stdout


def _references(value: object) -> Iterator[str]:
    if isinstance(value, dict):
        reference = value.get("$ref")
        if isinstance(reference, str):
            yield reference.removeprefix(REFERENCE)
        for part in value.values():
            yield from _references(part)
    elif isinstance(value, list):
        for part in value:
            yield from _references(part)


def _declaration(name: str, schema: Mapping[str, Any]) -> str:
    if "properties" not in schema:
        return f"{name} = {_type(schema)}"
    required = schema.get("required", ())
    fields = {
        field: _type(content) if field in required else f"NotRequired[{_type(content)}]"
        for field, content in schema["properties"].items()
    }
    if all(field.isidentifier() and not keyword.iskeyword(field) for field in fields):
        lines = "".join(f"\n    {field}: {kind}" for field, kind in fields.items())
        return f"class {name}(TypedDict):{lines}"
    lines = "".join(f'\n    "{field}": {kind},' for field, kind in fields.items())
    return f'{name} = TypedDict("{name}", {{{lines}\n}})'


def _type(schema: Mapping[str, Any]) -> str:
    """A type expression; references are in quotes, for classes that follow later."""
    if "$ref" in schema:
        return f'"{schema["$ref"].removeprefix(REFERENCE)}"'
    choices = schema.get("anyOf", schema.get("oneOf"))
    if choices:
        return _union(list(dict.fromkeys(_type(each) for each in choices)))
    if "const" in schema or "enum" in schema:
        values = schema.get("enum", [schema.get("const")])
        return f"Literal[{', '.join(repr(value) for value in values)}]".replace("'", '"')
    kind = schema.get("type")
    if kind == "array":
        return f"list[{_items(schema)}]"
    if kind == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"dict[str, {_type(schema['additionalProperties'])}]"
    return NAMES.get(str(kind), "Any")


def _items(schema: Mapping[str, Any]) -> str:
    parts = schema.get("prefixItems", [schema.get("items", {})])
    return _union(list(dict.fromkeys(_type(each) for each in parts)))


def _union(kinds: list[str]) -> str:
    if len(kinds) > 1 and any(kind.startswith('"') for kind in kinds):  # a string has no operator |
        return '"' + " | ".join(kinds).replace('"', "") + '"'
    return " | ".join(kinds)


if __name__ == "__main__":
    TARGET.write_text(python_source(), "utf-8")
