"""Data for researchers: exports in the background, the data dictionary, streamed files.

exports/views has one SQL view per table, exports/lists the lists by page, exports/fhir FHIR.
Frozen data belong to releases.
"""
