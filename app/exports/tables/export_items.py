"""The table of items: a row an effective record, or a row a component of it."""

from collections.abc import Iterator, Sequence
from typing import cast

from sqlalchemy.orm import Session

from app.exports.export_spec import ExportSpec
from app.exports.tables.export_components import HEADLINE_COMPONENTS, Amounts, FoodContents, components_for, long_batch
from app.exports.tables.export_provenance import Provenance
from app.exports.tables.export_table import Table
from app.exports.tables.record_queries import Keys, More, export_batches
from app.http.tables.columns import Batch, Part, PartOfBatch, rows_of
from app.http.tables.component_columns import KNOWN, LONG_AMOUNT, OF_COMPONENT, wide_part
from app.http.tables.geojson_rows import POINT
from app.http.tables.record_columns import (
    AMOUNTS,
    CONSUMED_G,
    HEADLINES,
    OF_FOOD,
    OF_MEAL,
    PROVENANCE_PARTS,
    RECORD_ID,
    RECORD_PARTS,
    STATE,
)
from app.people.access.caller import Caller, visible_rows
from app.records.page_queries import search_of

CONSUMED = Part("numbers", (CONSUMED_G,))
OF_LONG = (RECORD_ID, OF_MEAL, STATE, OF_FOOD)


def item_table(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    """As the filters of GET /v1/records choose, in the order of capture."""
    if spec.layout == "long":
        return _long(session, caller, spec)
    parts: tuple[Part, ...] = (*RECORD_PARTS, *PROVENANCE_PARTS) if spec.provenance else RECORD_PARTS
    gives: list[More] = [Provenance(session)] if spec.provenance else []
    if spec.components == "all":
        components = components_for(session, caller, spec)
        part, contents = wide_part(components), FoodContents(session, components)
        if components:  # else no food in use is known to have any
            parts = (*parts, part)
            gives.append(
                lambda keys: [PartOfBatch(part, rows_of(part, contents.amounts(keys.food_ids, keys.consumed_g)))]
            )
    all_parts = (*parts, POINT) if spec.output == "geojson" else parts

    def more(keys: Keys) -> Batch:
        return [part for give in gives for part in give(keys)]

    def batches() -> Iterator[Batch]:
        yield from export_batches(session, search_of(session, visible_rows(caller, spec.filters)), all_parts, more)

    return Table(parts, batches())


def _long(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    is_headline = spec.components == "headline"
    components = HEADLINE_COMPONENTS if is_headline else components_for(session, caller, spec)
    contents = FoodContents(session, components)

    def batches() -> Iterator[Batch]:
        kept: list[Keys] = []

        def more(keys: Keys) -> Batch:
            kept[:] = [keys]
            return [PartOfBatch(CONSUMED, keys.consumed_g)]

        search = search_of(session, visible_rows(caller, spec.filters))
        for *own, of_record in export_batches(session, search, (*OF_LONG, CONSUMED, AMOUNTS), more):
            food_ids, consumed_g = kept[0].food_ids, kept[0].consumed_g
            if is_headline:  # as the record has them
                amounts = [cast("Amounts", row[-len(HEADLINES) :]) for row in of_record.as_tuples()]
            else:
                amounts = contents.amounts(food_ids, consumed_g)
            yield from _in_pieces(own, amounts, contents.per_100_g(food_ids))

    def _in_pieces(
        own: Sequence[PartOfBatch], amounts: Sequence[Amounts], per_100_g: Sequence[Amounts]
    ) -> Iterator[Batch]:
        size = max(1, MOST_LONG_ROWS // max(1, len(components)))
        for start in range(0, len(amounts), size):
            end = start + size
            piece = [each.piece(start, end) for each in own]
            pairs = [
                list(zip(*pair, strict=True)) for pair in zip(amounts[start:end], per_100_g[start:end], strict=True)
            ]
            yield long_batch(piece, components, pairs, LONG_AMOUNT)

    return Table((*OF_LONG, CONSUMED, OF_COMPONENT, LONG_AMOUNT, KNOWN), batches() if components else iter(()))


MOST_LONG_ROWS = 10_000  # of a batch
