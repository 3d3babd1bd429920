"""One meal from the phone to its volumes.

upload: calls of phones. estimate: the job's work, in the worker and its child.
stored: the rows of a meal, its photographs and its time, which records and jobs build on.
"""
