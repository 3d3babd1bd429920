"""Pages of a study's figures and files: overview, exports, releases."""
