"""Batches as NDJSON: an object a line, as a JSON page has them but for the food, which is food_key and food_name."""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

from pydantic_core import to_json

from app.http.tables.columns import Batch, Cell, ConvertedOnce, Part, PartOfBatch, Row, as_row

Members = dict[Part, ConvertedOnce[Cell | Row, str]]


def encode_ndjson(parts: Sequence[Part], batches: Iterable[Batch]) -> Iterator[bytes]:
    """Each batch's rows; nothing at all of no rows."""
    shared = shared_members(parts)
    for batch in batches:
        yield ("{" + "}\n{".join(member_texts(batch, shared)) + "}\n").encode()


def shared_members(parts: Sequence[Part]) -> Members:
    """The texts of shared parts' rows, made once each."""
    return {part: ConvertedOnce(partial(_members, part)) for part in parts if part.type == "shared"}


def member_texts(batch: Batch, shared: Members) -> Iterator[str]:
    """Each row as the members of a JSON object, without its braces."""
    return map(",".join, zip(*(_texts(part, shared) for part in batch), strict=True))


def _texts(some: PartOfBatch, shared: Members) -> Sequence[str]:
    names = _names(some.part)
    match some.part.type:
        case "id":
            return [f'"{names[0]}":"{text}"' for text in some.rows]
        case "numbers":
            objects = [dict(zip(names, row, strict=True)) for row in some.as_tuples()]
            return to_json(objects)[2:-2].decode().split("},{")
        case "shared":
            return shared[some.part].of(some.rows)


def _members(part: Part, values: Cell | Row) -> str:
    return to_json(dict(zip(_names(part), as_row(part.columns, values), strict=True)))[1:-1].decode()


def _names(part: Part) -> tuple[str, ...]:
    return tuple(column.name for column in part.columns)
