"""Fixtures of the tests that walk through the pages in a browser."""

from tests.e2e.browser import chromium, open_page

__all__ = ["chromium", "open_page"]
