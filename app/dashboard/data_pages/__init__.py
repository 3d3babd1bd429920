"""Pages of a study's data: overview, exports, releases."""
