"""Builds the starter food table in app/nutrition/starter from public releases and a selection (docs/food-table.md)."""
