"""Small changes of a Python file, each of which a test should notice: operators, constants, conditions, statements."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

OTHER_COMPARISON: dict[type[ast.cmpop], str] = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
OTHER_OPERATOR: dict[type[ast.operator], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.FloorDiv: "*",
    ast.Mod: "*",
    ast.Pow: "*",
}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True, slots=True)
class Mutation:
    """One change. start, end: offsets of the replaced text in the source, in UTF-8 bytes. lines: first and last."""

    rule: str
    start: int
    end: int
    replacement: str
    lines: tuple[int, int]

    def apply(self, source: bytes) -> bytes:
        """Return the source with the change."""
        return source[: self.start] + self.replacement.encode() + source[self.end :]


def mutations(source: bytes) -> list[Mutation]:
    """Return all mutations of a file that still compile, in the order of the source."""
    reader = _Reader(source)
    found = [mutation for node in ast.walk(reader.tree) for mutation in reader.of_node(node)]
    return sorted(
        (each for each in found if _compiles(each.apply(source))),
        key=lambda each: (each.start, each.rule),
    )


class _Reader:
    def __init__(self, source: bytes) -> None:
        self.tree = ast.parse(source)
        self._source = source
        self._line_starts = [0]
        for line in source.splitlines(keepends=True):
            self._line_starts.append(self._line_starts[-1] + len(line))
        self._annotations = {
            id(part)
            for node in ast.walk(self.tree)
            for whole in _annotations(node)
            for part in ast.walk(whole)
        }

    def of_node(self, node: ast.AST) -> Iterator[Mutation]:
        """Yield the mutations of this node alone."""
        if id(node) in self._annotations:
            return
        match node:
            case ast.Compare(left=left, ops=[operator], comparators=[right]):
                yield self._between(left, right, OTHER_COMPARISON[type(operator)])
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in OTHER_OPERATOR:
                yield self._between(left, right, OTHER_OPERATOR[type(operator)])
            case ast.BoolOp(op=operator, values=[left, right]):
                yield self._between(left, right, "or" if isinstance(operator, ast.And) else "and")
            case ast.Constant():
                yield from self._of_constant(node)
            case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test):
                yield self._whole("condition", test, f"(not ({self._text(test)}))")
            case ast.stmt():
                yield from self._of_statement(node)

    def _of_constant(self, node: ast.Constant) -> Iterator[Mutation]:
        match node.value:
            case bool(value):
                yield self._whole("constant", node, str(not value))
            case int(value):
                yield self._whole("constant", node, str(value + 1))
            case float(value):
                yield self._whole("constant", node, repr(value * 1.5 if value else 1.0))

    def _of_statement(self, node: ast.stmt) -> Iterator[Mutation]:
        match node:
            case (
                ast.Expr(value=ast.Call())
                | ast.Expr(value=ast.Await())
                | ast.AugAssign()
                | ast.Raise()
            ):
                yield self._whole("statement", node, "pass")
            case ast.Return(value=value) if value is not None and not _is_none(value):
                yield self._whole("statement", node, "return None")

    def _between(self, left: ast.expr, right: ast.expr, operator: str) -> Mutation:
        """Replace the operator; brackets around the operands stay where they are."""
        start, end = self._span(left)[1], self._span(right)[0]
        text = self._source[start:end].decode()
        closing = text[: len(text) - len(text.lstrip(") \n\\"))]
        opening = text[len(text.rstrip("( \n\\")) :]
        return Mutation(
            "operator", start, end, f"{closing} {operator} {opening}", _lines(left, right)
        )

    def _whole(self, rule: str, node: ast.expr | ast.stmt, replacement: str) -> Mutation:
        return Mutation(rule, *self._span(node), replacement, _lines(node, node))

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        last_line, last_column = node.end_lineno or node.lineno, node.end_col_offset or 0
        return self._line_starts[node.lineno - 1] + node.col_offset, self._line_starts[
            last_line - 1
        ] + last_column

    def _text(self, node: ast.expr) -> str:
        start, end = self._span(node)
        return self._source[start:end].decode()


def _annotations(node: ast.AST) -> Iterator[ast.AST]:
    """Types, which nothing runs."""
    match node:
        case ast.AnnAssign(annotation=annotation) | ast.arg(annotation=ast.AST() as annotation):
            yield annotation
        case (
            ast.FunctionDef(returns=ast.AST() as returns)
            | ast.AsyncFunctionDef(returns=ast.AST() as returns)
        ):
            yield returns


def _lines(first: ast.expr | ast.stmt, last: ast.expr | ast.stmt) -> tuple[int, int]:
    return first.lineno, last.end_lineno or last.lineno


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _compiles(source: bytes) -> bool:
    try:
        compile(source, "mutant", "exec")
    except (SyntaxError, ValueError):
        return False
    return True
