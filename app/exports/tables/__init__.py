"""The tables that leave: items, meals, days, photographs, participants; their rows, components and provenance."""
