"""Batches as files: the same bytes however a batch holds its rows, and every text reads back."""

import csv
import io
import json

import pytest
from pyarrow import parquet

from app.exports.tables.export_tables import encoded
from app.http.tables.columns import Column, Part, PartOfBatch
from app.http.tables.geojson_rows import POINT

ID = Part("id", (Column("id", "id"),))
FOOD = Part(
    "shared", (Column("name", "word"), Column("day", "day"), Column("flags", "words"), Column("is_new", "boolean"))
)
GRAMS = Part("numbers", (Column("grams", "number"), Column("count", "integer")))
PARTS = (ID, FOOD, GRAMS)
APPLE, CAKE = ("apple", "2026-11-27", ("a", "b"), True), ("", None, (), None)


def batch(*, by_place):
    foods = PartOfBatch(FOOD, [APPLE, CAKE], [1, 0, 1]) if by_place else PartOfBatch(FOOD, [CAKE, APPLE, CAKE])
    point = (
        PartOfBatch(POINT, [(16.4, 48.2), (None, None)], [0, 1, 0])
        if by_place
        else PartOfBatch(POINT, [(16.4, 48.2), (None, None), (16.4, 48.2)])
    )
    return [PartOfBatch(ID, ["x", "y", "z"]), foods, PartOfBatch(GRAMS, [(0.5, 1), (None, 2), (1e22, 3)])], point


@pytest.mark.parametrize("output", ["csv", "ndjson", "parquet", "geojson"])
def test_rows_given_by_place_are_written_as_rows_given_one_by_one(output):
    def file(*, by_place):
        rows, point = batch(by_place=by_place)
        return b"".join(encoded(output, PARTS, [[*rows, point] if output == "geojson" else rows]))

    assert file(by_place=True) == file(by_place=False)


def test_each_row_has_the_values_at_its_place_and_pieces_and_repeated_rows_keep_their_order():
    rows, _ = batch(by_place=True)
    lines = b"".join(encoded("ndjson", PARTS, [rows])).splitlines()
    names = [json.loads(line)["name"] for line in lines]
    assert names == ["", "apple", ""]
    table = parquet.read_table(io.BytesIO(b"".join(encoded("parquet", PARTS, [rows]))))
    assert table["flags"].to_pylist() == [[], ["a", "b"], []]
    assert list(rows[1].piece(1, 3).as_tuples()) == [APPLE, CAKE]
    assert list(rows[0].piece(1, 3).repeated(2).as_tuples()) == [("y",), ("y",), ("z",), ("z",)]
    assert list(rows[1].repeated(2).as_tuples()) == [CAKE, CAKE, APPLE, APPLE, CAKE, CAKE]


@pytest.mark.parametrize("text", ["line\nfeed", "carriage\rreturn", "a,b", 'a "quoted" word', " blank ", "größe"])
def test_text_of_a_csv_cell_reads_back(text):
    part = Part("shared", (Column("text", "word"), Column("next", "word")))
    file = b"".join(encoded("csv", (part,), [[PartOfBatch(part, [(text, "next")])]])).decode()
    assert list(csv.reader(io.StringIO(file, newline=""))) == [["text", "next"], [text, "next"]]
