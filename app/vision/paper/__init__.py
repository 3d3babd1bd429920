"""The founding paper's own methods: matching and depth as printed, slices completed by symmetry."""
