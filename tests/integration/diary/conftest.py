"""A study in which people talked about a meal, as a fixture."""

from tests.integration.records.talking import talked_over

__all__ = ["talked_over"]
