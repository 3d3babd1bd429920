"""Batches as GeoJSON (RFC 7946): one FeatureCollection, a feature a row, its place as the point; null where unknown."""

from collections.abc import Iterable, Iterator, Sequence

from pydantic_core import to_json

from app.http.tables.columns import Batch, Cell, Column, Part, Row, as_row
from app.http.tables.ndjson_rows import member_texts, shared_members

UNKNOWN_PLACE = "Not told, or the study keeps no locations."
LONGITUDE = Column("longitude", "number", "deg", "WGS84, as far as the study keeps locations.", empty=UNKNOWN_PLACE)
LATITUDE = Column("latitude", "number", "deg", "WGS84, as far as the study keeps locations.", empty=UNKNOWN_PLACE)
POINT = Part("shared", (LONGITUDE, LATITUDE))


def encode_geojson(parts: Sequence[Part], batches: Iterable[Batch]) -> Iterator[bytes]:
    """parts: the features' properties, the first of them their id. Behind them a batch has the POINT of each row."""
    shared = shared_members(parts)
    head = '{"type":"FeatureCollection","features":['
    for *properties, place in batches:
        texts = [
            f'{{"type":"Feature","id":"{one}","geometry":{_geometry(point)},"properties":{{{members}}}}}'
            for one, point, members in zip(
                properties[0].rows, place.rows, member_texts(properties, shared), strict=True
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
