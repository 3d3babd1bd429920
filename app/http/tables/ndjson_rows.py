"""Batches as NDJSON: an object a line, as a JSON page has them but for the food, which is food_key and food_name."""

from collections.abc import Iterable, Iterator, Sequence

from pydantic_core import to_json

from app.http.tables.columns import Batch, Cell, ColumnType, ConvertedOnce, PartOfBatch

Words = ConvertedOnce[Cell, str]


def encode_ndjson(batches: Iterable[Batch]) -> Iterator[bytes]:
    """Each batch's rows; nothing at all of no rows."""
    words = word_texts()
    for batch in batches:
        yield ("{" + "}\n{".join(member_texts(batch, words)) + "}\n").encode()


def word_texts() -> Words:
    """The JSON of words and lists of words, made once each."""
    return ConvertedOnce(lambda value: to_json(value).decode())


def member_texts(batch: Batch, words: Words) -> Iterator[str]:
    """Each row as the members of a JSON object, without its braces."""
    return map(",".join, zip(*(_texts(part.deduplicated(), words) for part in batch), strict=True))


def _texts(part_of_batch: PartOfBatch, words: Words) -> Sequence[str]:
    columns = part_of_batch.part.columns
    members = ",".join(f'"{column.name}":%s' for column in columns)
    cells = (
        _cells(column.type, values, words) for column, values in zip(columns, part_of_batch.columns(), strict=True)
    )
    return part_of_batch.spread([members % row for row in zip(*cells, strict=True)])


def _cells(column_type: ColumnType, values: Sequence[Cell], words: Words) -> Sequence[str]:
    match column_type:
        case "word" | "words":
            return words.of(values)
        case "number" | "integer" | "boolean":
            return to_json(values)[1:-1].decode().split(",")
        case "id" | "instant" | "local time" | "day":  # nothing in them that JSON would escape
            return ["null" if value is None else f'"{value}"' for value in values]
