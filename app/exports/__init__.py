"""Data for researchers: exports in the background, the data dictionary, streamed files.

exports/views has one SQL view per table, exports/lists the lists by page.
releases freezes them under a name, with checksums, and takes erased data out of them.
"""
