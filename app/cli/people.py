"""`tada admin` and `tada staff`: the people who run the server and work with the data.

Passwords come from a file, standard input or a prompt that does not show them; never from an argument, which every
user of the machine could read.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.database import opened_database
from app.core.errors import InvalidInputError

if TYPE_CHECKING:
    from app.people.access.access_tokens import EndedAccess
    from app.people.access.staff import StaffChange

admin_cli = typer.Typer(no_args_is_help=True, help="People who run the server.")
staff_cli = typer.Typer(no_args_is_help=True, help="People who sign in with a password.")

PasswordFile = Annotated[
    Path | None,
    typer.Option("--password-file", help="File whose first line is the password; -: standard input. Default: asked."),
]
LONGEST_PASSWORD_BYTES = 4096


@admin_cli.command("create")
def admin_create(name: str) -> None:
    """Make an admin and print the token, once."""
    from app.people.access.staff import create_admin

    with opened_database() as database:
        token = create_admin(database, name)
    print(token)
    print("Keep it: it is not shown again. Send it as `Authorization: Bearer TOKEN`.", file=sys.stderr)


@staff_cli.command("create")
def staff_create(
    name: str,
    admin: Annotated[bool, typer.Option("--admin", help="May do everything in every study.")] = False,
    password_file: PasswordFile = None,
) -> None:
    """Make a staff member with a password. An owner gives them a role in a study."""
    from app.people.access.passwords import Passwords
    from app.people.access.staff import create_staff

    password = read_password(password_file)
    with opened_database() as database:
        made = create_staff(database, Passwords(), name, is_admin=admin, password=password)
    print(f"{made.name} can sign in{' and is an admin' if admin else ''}.")


@staff_cli.command("password")
def staff_password(name: str, password_file: PasswordFile = None) -> None:
    """Give a staff member another password; their sessions and personal tokens end."""
    from app.people.access.staff import StaffChange

    ended = _change(name, StaffChange(password=read_password(password_file)))
    print(f"{name} has a new password.{ended.sentence}")


@staff_cli.command("disable")
def staff_disable(name: str) -> None:
    """Shut a staff member out: their sessions and tokens end for good. The last admin stays."""
    from app.people.access.staff import StaffChange

    ended = _change(name, StaffChange(is_disabled=True))
    print(f"{name} is disabled.{ended.sentence}")


@staff_cli.command("enable")
def staff_enable(name: str) -> None:
    """Let a disabled staff member sign in again."""
    from app.people.access.staff import StaffChange

    _change(name, StaffChange(is_disabled=False))
    print(f"{name} can sign in again.")


@staff_cli.command("list")
def staff_list() -> None:
    """Everybody by name: admin or not, with a password or by token only, disabled since when."""
    from app.people.access.staff import list_staff

    with opened_database() as database:
        cursor = None
        while True:
            page = list_staff(database, cursor=cursor, limit=1000)
            for row in page.rows:
                disabled = f", disabled {row.disabled_at:%Y-%m-%d}" if row.disabled_at is not None else ""
                by = "password" if row.password_hash is not None else "token only"
                print(f"{row.name}: {'admin' if row.is_admin else 'staff'}, {by}{disabled}")
            cursor = page.cursor
            if cursor is None:
                return


def read_password(path: Path | None) -> str:
    """The password, without the line's end. Raises InvalidInputError."""
    if path is None:
        if not sys.stdin.isatty():
            raise InvalidInputError(
                "There is nobody to ask for the password: give --password-file FILE, or - for stdin."
            )
        entered: str = typer.prompt("Password", hide_input=True, confirmation_prompt=True, err=True)
        return entered
    try:
        if str(path) == "-":
            content = sys.stdin.buffer.readline(LONGEST_PASSWORD_BYTES)
        else:
            with path.open("rb") as file:
                content = file.readline(LONGEST_PASSWORD_BYTES)
        return content.decode().rstrip("\r\n")
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise InvalidInputError(f"{path} is no text in UTF-8.") from None


def _change(name: str, change: "StaffChange") -> "EndedAccess":
    from app.people.access.passwords import Passwords
    from app.people.access.staff import change_staff

    with opened_database() as database:
        return change_staff(database, Passwords(), name, change).ended
