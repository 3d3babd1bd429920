"""Releases: a study's data frozen under a name, with checksums, and the removal of erased data from them."""
