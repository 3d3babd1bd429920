"""`tada staff` and `tada admin` on a database of their own."""

import io

import pytest
from typer.testing import CliRunner

from app.cli.main import cli
from app.cli.people import read_password
from app.core.errors import ConflictError, InvalidInputError, UnauthenticatedError
from app.db.session import Database
from app.people.access.passwords import Passwords
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import sign_in
from app.people.models import Staff

PASSWORD = "correct horse battery"
BOX = SecretBox("s" * 32)


@pytest.fixture
def tada(monkeypatch, prepared_database_url, tmp_path):
    monkeypatch.setenv("TADA_DATABASE_URL", prepared_database_url)
    monkeypatch.setenv("TADA_DATA_DIR", str(tmp_path / "data"))

    def run(*arguments, stdin=None):
        result = CliRunner().invoke(cli, list(arguments), input=stdin)
        if isinstance(result.exception, Exception):
            raise result.exception
        return result.output

    return run


@pytest.fixture
def database(prepared_database_url):
    database = Database(prepared_database_url)
    yield database
    database.dispose()


def test_staff_is_created_with_a_password_from_a_file_or_standard_input(tada, database, tmp_path):
    file = tmp_path / "password"
    file.write_bytes(PASSWORD.encode() + b"\r\nsecond line\n")
    assert "olga can sign in" in tada("staff", "create", "olga", "--password-file", str(file))
    assert not sign_in(database, BOX, Passwords(), "olga", PASSWORD).is_admin
    output = tada("staff", "create", "root", "--admin", "--password-file", "-", stdin=PASSWORD + "\n")
    assert PASSWORD not in output
    assert sign_in(database, BOX, Passwords(), "root", PASSWORD).is_admin


def test_new_password_disabling_and_enabling_and_turning_codes_off(tada, database):
    tada("admin", "create", "admin")
    tada("staff", "create", "olga", "--password-file", "-", stdin=PASSWORD)
    tada("staff", "password", "olga", "--password-file", "-", stdin="another " + PASSWORD)
    sign_in(database, BOX, Passwords(), "olga", "another " + PASSWORD)
    tada("staff", "disable", "olga")
    with pytest.raises(UnauthenticatedError):
        sign_in(database, BOX, Passwords(), "olga", "another " + PASSWORD)
    assert "olga: staff, password, disabled" in tada("staff", "list")
    tada("staff", "enable", "olga")
    sign_in(database, BOX, Passwords(), "olga", "another " + PASSWORD)
    assert "admin: admin, token only" in tada("staff", "list")
    with database.write() as session:
        session.query(Staff).filter_by(name="olga").one().totp_secret = BOX.seal("of a lost phone")
    assert "olga: staff, password and code" in tada("staff", "list")
    with pytest.raises(UnauthenticatedError):
        sign_in(database, BOX, Passwords(), "olga", "another " + PASSWORD)
    assert "olga can sign in without a code." in tada("staff", "totp-off", "olga")
    sign_in(database, BOX, Passwords(), "olga", "another " + PASSWORD)
    with pytest.raises(ConflictError):  # the last admin
        tada("staff", "disable", "admin")


def test_command_without_a_terminal_names_the_missing_option(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(InvalidInputError, match="--password-file"):
        read_password(None)


def test_unreadable_file_gives_a_message(tmp_path):
    with pytest.raises(InvalidInputError, match="cannot be read"):
        read_password(tmp_path / "absent")
    (tmp_path / "bytes").write_bytes(b"\xff\xfe")
    with pytest.raises(InvalidInputError, match="not UTF-8 text"):
        read_password(tmp_path / "bytes")
