"""Batches as GeoJSON (RFC 7946): one FeatureCollection, a feature a row, its place as the point; null where unknown."""

from collections.abc import Iterable, Iterator

from pydantic_core import to_json

from app.http.tables.columns import Batch, Cell, Column, Part, Row, as_row
from app.http.tables.ndjson_rows import member_texts, word_texts

UNKNOWN_PLACE = "Not told, or the study keeps no locations."
LONGITUDE = Column("longitude", "number", "deg", "WGS84, as far as the study keeps locations.", empty=UNKNOWN_PLACE)
LATITUDE = Column("latitude", "number", "deg", "WGS84, as far as the study keeps locations.", empty=UNKNOWN_PLACE)
POINT = Part("shared", (LONGITUDE, LATITUDE))


def encode_geojson(batches: Iterable[Batch]) -> Iterator[bytes]:
    """The first part of a batch is the features' id; behind their properties it has the POINT of each row."""
    words = word_texts()
    head = '{"type":"FeatureCollection","features":['
    for *properties, place in batches:
        geometries = place.spread(list(map(_geometry, place.rows)))
        texts = [
            f'{{"type":"Feature","id":"{record_id}","geometry":{geometry},"properties":{{{members}}}}}'
            for record_id, geometry, members in zip(
                properties[0].rows, geometries, member_texts(properties, words), strict=True
            )
        ]
        yield (head + "\n" + ",\n".join(texts)).encode()
        head = ","
    yield ("" if head == "," else head).encode() + b"\n]}\n"


def _geometry(point: Cell | Row) -> str:
    return (
        "null"
        if None in as_row(POINT.columns, point)
        else f'{{"type":"Point","coordinates":{to_json(point).decode()}}}'
    )
