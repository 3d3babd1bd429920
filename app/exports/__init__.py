"""Data for researchers: exports in the background, the data dictionary, streamed files.

exports/tables has the tables, exports/lists the lists by page, exports/fhir FHIR. Frozen data belong to releases.
"""
