"""Intakes of a person and of a group: reference intakes, energy requirement, usual intake, food groups."""
