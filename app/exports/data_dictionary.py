"""The data dictionary of a table as it would be exported now; `all` components are those of the foods in use."""

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.session import Database
from app.exports.export_spec import ExportSpec, check_spec
from app.exports.table_columns import columns_of
from app.foods.models import Component, Food, FoodNutrient
from app.http.columns.component_columns import ComponentColumn, component_column
from app.http.columns.dictionary import Column
from app.meals.stored.record_models import EffectiveRecord
from app.people.access.caller import Caller, visible_studies
from app.records.page_queries import studies_of


def columns_for(database: Database, caller: Caller, spec: ExportSpec) -> tuple[Column, ...]:
    """Return the table's columns from left to right.

    Raises InvalidInputError (`export_not_offered`).
    """
    check_spec(spec)
    if spec.components == "headline":
        return columns_of(spec, ())
    with database.read() as session:
        return columns_of(spec, _components_in_use(session, caller, spec))


def _components_in_use(session: Session, caller: Caller, spec: ExportSpec) -> list[ComponentColumn]:
    """Those that foods of the studies' records have, in the order of components.csv.

    Each food is looked up once in the index of records, however many records there are.
    """
    studies = studies_of(session, spec.filters.study_code, visible_studies(caller))
    first = sa.select(EffectiveRecord.food_id).where(EffectiveRecord.food_id == Food.id).limit(1)
    if studies is not None:
        first = first.where(EffectiveRecord.study_id.in_(studies))
    used = sa.select(Food.id).where(first.correlate(Food).scalar_subquery().is_not(None))
    of_foods = sa.select(FoodNutrient.component_id).where(FoodNutrient.food_id.in_(used))
    query = sa.select(Component).where(Component.id.in_(of_foods)).order_by(Component.id)
    return [
        component_column(
            component.number,
            component.name,
            component.unit,
            component.tagname,
            component.expression,
        )
        for component in session.scalars(query)
    ]
