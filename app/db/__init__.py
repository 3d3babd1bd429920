"""The database: sessions, column types, migrations, bulk access.

SQL of a domain is in its queries.py.
"""
