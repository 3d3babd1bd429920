"""Builds the index of how foods look that ships in app/identification/shipped (docs/identification.md)."""
