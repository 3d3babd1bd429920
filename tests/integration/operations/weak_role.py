"""A role of PostgreSQL that may connect to a database of somebody else's, and no more."""

import contextlib
import uuid

import sqlalchemy as sa

from app.db.session import Database


@contextlib.contextmanager
def weak_role(url):
    """Its URL, and the owner's database."""
    name = f"weak_{uuid.uuid4().hex}"
    owner = Database(url)
    with owner.write() as session:
        session.execute(sa.text("REVOKE CREATE ON SCHEMA public FROM PUBLIC"))  # as from PostgreSQL 15 on
        session.execute(sa.text(f"CREATE ROLE {name} LOGIN"))
    try:
        yield sa.make_url(url).set(username=name).render_as_string(hide_password=False), owner
    finally:
        with owner.write() as session:
            session.execute(sa.text(f"DROP OWNED BY {name}"))
            session.execute(sa.text(f"DROP ROLE {name}"))
        owner.dispose()
