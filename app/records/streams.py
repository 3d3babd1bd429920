"""An index in which meals stand in a page's order, read along: its page, a sample of it, its two ends.

The branches of an index (a study and a status, a food and a study) are merged, as in record_pages;
the merge stops with the page.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql

from app.db.statements import AnyColumn, AnyQuery, Condition, Conditions
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.records.page_queries import Branch, Key, is_list_of_flags

MOST_PLANNED = 8  # PostgreSQL plans each branch by itself; more of them are given as arrays


@dataclass(frozen=True, slots=True)
class Stream:
    """An index in which meals stand in their order, branch by branch.

    model: Meal or EffectiveRecord
    keys: the columns that a branch has values of
    part: the condition of a partial index
    is_small: no index has the order, and the meals are so few that they are read and sorted
    """

    model: type[Meal | EffectiveRecord]
    keys: tuple[AnyColumn, ...]
    branches: Sequence[Branch]
    part: Conditions = ()
    is_small: bool = False

    @property
    def columns(self) -> tuple[AnyColumn, AnyColumn]:
        """The instant and the id of the meal."""
        if self.model is Meal:
            return Meal.captured_at, Meal.id
        return EffectiveRecord.captured_at, EffectiveRecord.meal_id.label("id")

    def order(self, *, is_newest_first: bool) -> tuple[AnyColumn, AnyColumn]:
        """As the index has it, forwards or backwards."""
        ordered = (
            self.model.captured_at,
            Meal.id if self.model is Meal else EffectiveRecord.meal_id,
        )
        return (ordered[0].desc(), ordered[1].desc()) if is_newest_first else ordered


@dataclass(frozen=True, slots=True)
class MealSearch:
    """A filter whose names are ids: the index to read along, and what each meal of it must fulfil besides."""

    stream: Stream
    conditions: Conditions
    is_on_sqlite: bool

    def page(self, after: Key | None, limit: int, *, is_newest_first: bool = True) -> sa.CTE:
        """At most `limit` meals behind `after` in this order: captured_at and id, each meal once; in no order."""
        conditions = self.conditions
        if after is not None:
            conditions = (*conditions, self._behind(after, is_newest_first=is_newest_first))
        order = _named_order(is_newest_first=is_newest_first)
        if self.is_on_sqlite:
            arms = list(self._arms(conditions))
            is_of_meals = self.stream.model is Meal
            merged = (
                (sa.union_all if is_of_meals else sa.union)(*arms)
                if len(arms) > 1
                else arms[0].distinct()
            )
            if self.stream.is_small:
                merged = sa.select(merged.cte("found").prefix_with("MATERIALIZED"))
            return merged.order_by(*order).limit(limit).cte("page")
        every = self._limited(conditions, limit, is_newest_first=is_newest_first)
        return (
            sa.select(every.c.captured_at, every.c.id)
            .distinct()
            .order_by(*order)
            .limit(limit)
            .cte("page")
        )

    def sample(self, after: Key | None, most: int, *, is_newest_first: bool) -> sa.Select[int, Any]:
        """Of the entries behind `after`: how many, up to `most`, and how far these reach in time.

        A meal of two such records is two.
        """
        conditions = self.conditions
        if after is not None:
            conditions = (*conditions, self._behind(after, is_newest_first=is_newest_first))
        order = _named_order(is_newest_first=is_newest_first)
        if self.is_on_sqlite:
            arms = list(self._arms(conditions))
            every: Any = (
                (sa.union_all(*arms) if len(arms) > 1 else arms[0]).order_by(*order).limit(most)
            )
        else:
            each = self._limited(
                conditions, most, is_newest_first=is_newest_first, is_distinct=False
            )
            every = sa.select(each).order_by(*order).limit(most)
        statement = every.subquery("sample")
        reach = (sa.func.min if is_newest_first else sa.func.max)(
            statement.c.captured_at, type_=Meal.captured_at.type
        )
        return sa.select(sa.func.count(), reach).select_from(statement)

    def ends(self) -> sa.Select[Any, Any]:
        """When the first and the last of these were; each branch is asked at its two ends."""
        stream, names = self.stream, [f"key_{number}" for number in range(len(self.stream.keys))]
        listed = self._listed(names) if names else None
        of_branch = [
            self._is(key, listed.c[name])
            for key, name in zip(stream.keys, names, strict=True)
            if listed is not None
        ]
        instant = stream.model.captured_at
        statement = sa.select(instant).where(*stream.part, *self.conditions, *of_branch).limit(1)
        ends = [
            statement.order_by(*stream.order(is_newest_first=is_last))
            .correlate(listed)
            .scalar_subquery()
            for is_last in (False, True)
        ]
        if listed is None:
            return sa.select(ends[0], ends[1])
        first, last = (
            sa.func.min(ends[0], type_=instant.type),
            sa.func.max(ends[1], type_=instant.type),
        )
        return sa.select(first, last).select_from(listed)

    def _listed(self, names: Sequence[str]) -> sa.FromClause:
        """The branches as rows."""
        if self.is_on_sqlite:
            columns = (
                sa.column(name, _sent_as(key))
                for name, key in zip(names, self.stream.keys, strict=True)
            )
            return (
                sa.values(*columns, name="listed")
                .data([tuple(values) for values in self.stream.branches])
                .cte()
            )
        arrays = (
            sa.literal(list(values), postgresql.ARRAY(_sent_as(key)))
            for key, values in zip(
                self.stream.keys, zip(*self.stream.branches, strict=True), strict=True
            )
        )
        return sa.func.unnest(*arrays).table_valued(*names).render_derived("listed")

    def _arms(self, conditions: Conditions) -> Iterator[AnyQuery]:
        """A query a branch."""
        statement = sa.select(*self.stream.columns).where(*self.stream.part, *conditions)
        for values in self.stream.branches:
            yield statement.where(
                *(self._is(key, value) for key, value in zip(self.stream.keys, values, strict=True))
            )

    def _limited(
        self, conditions: Conditions, limit: int, *, is_newest_first: bool, is_distinct: bool = True
    ) -> sa.FromClause:
        """PostgreSQL: each branch read along its index and no further than `limit`.

        A few branches are planned one by one; more are given as arrays, and one plan is made for
        all.
        """
        stream, order = self.stream, self.stream.order(is_newest_first=is_newest_first)

        def limited(arm: AnyQuery) -> AnyQuery:
            return (
                (arm.distinct() if is_distinct and stream.model is not Meal else arm)
                .order_by(*order)
                .limit(limit)
            )

        if len(stream.branches) <= MOST_PLANNED:
            arms = [limited(arm).subquery() for arm in self._arms(conditions)]
            return sa.union_all(*(sa.select(arm) for arm in arms)).subquery("branch")
        names = [f"key_{number}" for number in range(len(stream.keys))]
        listed = self._listed(names)
        of_branch = [
            self._is(key, listed.c[name]) for key, name in zip(stream.keys, names, strict=True)
        ]
        statement = sa.select(*stream.columns).where(*stream.part, *conditions, *of_branch)
        branch = limited(statement).lateral("branch")
        return sa.select(branch).select_from(listed.join(branch, sa.true())).subquery("every")

    def _is(self, key: AnyColumn, value: Any) -> Condition:
        """Flags are compared as the database keeps them: whole lists, given as text."""
        if key is not EffectiveRecord.flags:
            return cast(Condition, key == value)
        return is_list_of_flags(key, value, is_on_sqlite=self.is_on_sqlite)

    def _behind(self, after: Key, *, is_newest_first: bool) -> Condition:
        instant, meal = self.stream.model.captured_at, self.stream.columns[1]
        key = sa.tuple_(
            sa.bindparam(None, after[0], type_=Meal.captured_at.type),
            sa.bindparam(None, after[1], type_=Meal.id.type),
        )
        here = sa.tuple_(instant, meal.element if isinstance(meal, sa.Label) else meal)
        return here < key if is_newest_first else here > key


def _named_order(*, is_newest_first: bool) -> tuple[AnyColumn, AnyColumn]:
    instant: Any = sa.literal_column("captured_at")
    meal: Any = sa.literal_column("id")
    return (instant.desc(), meal.desc()) if is_newest_first else (instant, meal)


def _sent_as(key: AnyColumn) -> Any:
    return sa.Text() if key is EffectiveRecord.flags else key.type
