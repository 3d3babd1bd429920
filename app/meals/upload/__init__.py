"""Calls of phones: meals, after-meal pairs, declared meals, checks before sending, waiting, cancelling, retrying."""
