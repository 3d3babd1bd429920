"""An estimate: the job's work, the child's tasks, the pipeline's answer as JSON, and saving it exactly once.

The pipeline itself is in vision; claiming jobs belongs to jobs.
"""
