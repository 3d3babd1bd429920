"""Intakes of persons and groups: reference intakes, energy requirement, usual intake, food groups."""
