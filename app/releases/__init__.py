"""Releases: a study's data frozen under a name, with checksums, and what erasures do to them."""
