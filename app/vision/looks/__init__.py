"""What a food looks like, as numbers: the Visual Characterization Metrics (VCM) by which it is identified."""
