"""Fixture: a study with a meal that has review events."""

from tests.integration.records.talking import talked_over

__all__ = ["talked_over"]
