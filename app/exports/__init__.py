"""What leaves the server for researchers: exports in the background, the data dictionary, streamed files.

Tables are in exports/tables, pages of lists in exports/lists, FHIR in exports/fhir. Frozen data belong to releases.
"""
