"""The food table: releases, foods, densities, recipes, reference intakes, and reading them.

Arithmetic on nutrients belongs to nutrition, which knows no database. Which food is on a photograph
belongs to candidates.
"""
