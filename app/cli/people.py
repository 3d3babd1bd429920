"""`tada admin` and `tada staff`: admins and staff.

Passwords are read from a file, standard input or a hidden prompt, never from an argument, which
every user of the machine could read.
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
    typer.Option(
        "--password-file",
        help="File whose first line is the password; -: standard input. Default: a prompt.",
    ),
]
LONGEST_PASSWORD_BYTES = 4096


@admin_cli.command("create")
def admin_create(name: str) -> None:
    """Create an admin and print the token, which is not shown again."""
    from app.people.access.staff import create_admin

    with opened_database() as database:
        token = create_admin(database, name)
    print(token)
    print(
        "Keep it: it is not shown again. Send it as `Authorization: Bearer TOKEN`.", file=sys.stderr
    )


@staff_cli.command("create")
def staff_create(
    name: str,
    admin: Annotated[
        bool, typer.Option("--admin", help="May do everything in every study.")
    ] = False,
    password_file: PasswordFile = None,
) -> None:
    """Create a staff member with a password. An owner gives them a role in a study."""
    from app.people.access.passwords import Passwords
    from app.people.access.staff import create_staff

    password = read_password(password_file)
    with opened_database() as database:
        member = create_staff(database, Passwords(), name, is_admin=admin, password=password)
    print(f"{member.name} can sign in{' and is an admin' if admin else ''}.")


@staff_cli.command("password")
def staff_password(name: str, password_file: PasswordFile = None) -> None:
    """Set a new password for a staff member; their sessions and personal tokens end."""
    from app.people.access.staff import StaffChange

    ended = _change(name, StaffChange(password=read_password(password_file)))
    print(f"{name} has a new password.{ended.sentence}")


@staff_cli.command("totp-off")
def staff_totp_off(name: str) -> None:
    """Ask a staff member who lost their phone for no more codes; the password is still needed."""
    from app.people.access.staff import StaffChange

    _change(name, StaffChange(ends_totp=True))
    print(f"{name} can sign in without a code.")


@staff_cli.command("disable")
def staff_disable(name: str) -> None:
    """Disable a staff member and end their sessions and tokens for good.

    The last admin cannot be disabled.
    """
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
    """List all staff by name: admin or not, password or token only, and since when they are disabled."""
    from app.http.paging import all_rows
    from app.people.access.staff import list_staff

    with opened_database() as database:
        for row in all_rows(lambda cursor: list_staff(database, cursor=cursor, limit=1000)):
            disabled = f", disabled {row.disabled_at:%Y-%m-%d}" if row.disabled_at else ""
            by = "password" if row.password_hash is not None else "token only"
            by += " and code" if row.has_totp else ""
            print(f"{row.name}: {'admin' if row.is_admin else 'staff'}, {by}{disabled}")


def read_password(path: Path | None) -> str:
    """Return the password without the line ending. Raises InvalidInputError."""
    if path is None:
        if not sys.stdin.isatty():
            raise InvalidInputError(
                "Standard input is not a terminal: give the password by --password-file FILE, or - for standard input."
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
        raise InvalidInputError(f"{path} is not UTF-8 text.") from None


def _change(name: str, change: "StaffChange") -> "EndedAccess":
    from app.people.access.passwords import Passwords
    from app.people.access.staff import change_staff

    with opened_database() as database:
        return change_staff(database, Passwords(), name, change).ended
