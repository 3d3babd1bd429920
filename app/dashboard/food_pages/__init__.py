"""Pages of foods, densities and vessels."""
