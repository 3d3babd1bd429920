"""Whole processes and browsers. A package, so that one server and one browser are shared by all of its files."""
