"""Make an index of foods from described regions: metric, calibration, archive."""
