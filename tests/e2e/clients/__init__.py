"""Clients of the API, all on one server."""
