"""/v1/data-dictionary: the meaning of every column of an exported table, as JSON, CSV or Table Schema."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from fastapi.responses import JSONResponse, Response

from app.exports.data_dictionary import columns_for
from app.exports.data_dictionary_schemas import DataDictionary, DictionaryColumn, TableSchema
from app.exports.export_files import ComponentsIn, LayoutIn, ProvenanceIn
from app.exports.export_spec import ExportSpec, Rows
from app.exports.table_columns import key_of
from app.http.columns.dictionary import DICTIONARY_COLUMNS, dictionary_csv, entries, table_schema
from app.http.file_formats import FORMATS
from app.http.model_response import ModelResponse
from app.http.problems import problem_responses
from app.http.row_filter import RowFilter
from app.people.access.deps import CurrentCaller, State

router = APIRouter(prefix="/v1", tags=["exports"])


@router.get(
    "/data-dictionary",
    response_model=DataDictionary | TableSchema,
    responses={
        200: {
            "content": {"text/csv": {"schema": {"type": "string"}}},
            "description": "As JSON or CSV.",
        },
        **problem_responses(401, 422),
    },
)
def get_data_dictionary(
    state: State,
    caller: CurrentCaller,
    rows: Annotated[Rows, Query(description="Which table.")] = "items",
    layout: LayoutIn = "wide",
    components: ComponentsIn = "headline",
    study: Annotated[
        str | None, Query(max_length=64, description="Of all components, those of its foods.")
    ] = None,
    output: Annotated[
        Literal["json", "csv", "table-schema"],
        Query(
            alias="format",
            description="table-schema: Frictionless Data's, to check a CSV file with.",
        ),
    ] = "json",
    provenance: ProvenanceIn = True,
) -> Response:
    """Every column's name, type, unit, meaning, possible values, and the meaning of an empty cell."""
    spec = ExportSpec(
        rows, layout, components=components, filters=RowFilter(study), provenance=provenance
    )
    columns = columns_for(state.database, caller, spec)
    if output == "table-schema":
        return JSONResponse(table_schema(columns, key=key_of(spec)))
    dictionary = entries(columns)
    if output == "csv":
        headers = {"Content-Disposition": f'attachment; filename="data-dictionary-{rows}.csv"'}
        return Response(
            dictionary_csv(dictionary), media_type=FORMATS["csv"].media_type, headers=headers
        )
    names = [column.name for column in DICTIONARY_COLUMNS]
    body = DataDictionary(
        rows=rows,
        layout=layout,
        components=components,
        key=list(key_of(spec)),
        columns=[
            DictionaryColumn.model_validate(dict(zip(names, row, strict=True)))
            for row in dictionary
        ],
    )
    return ModelResponse(body)
