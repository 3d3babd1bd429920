"""The tables that leave: items, meals, days, photographs; their rows, components and provenance."""
