"""Erasure, withdrawal, retention, a person's own data; the ledger of erasures and the deletion of blobs.

Only privacy/erase.py deletes. The audit log is in people/access.
"""
