"""The pipeline's version, apart from the pipeline: the API names it and needs no NumPy for it."""

PIPELINE_VERSION = "22"  # changes whenever the same photographs may give another answer
