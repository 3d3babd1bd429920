"""Types of statements whose columns are chosen at run time."""

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute

AnyColumn = sa.ColumnElement[Any] | InstrumentedAttribute[Any]
AnyQuery = sa.Select[*tuple[Any, ...]]
Condition = sa.ColumnElement[bool]
Conditions = tuple[Condition, ...]
