"""Commands that work on a server's data folder itself: tokens, backup, removal of what nothing uses."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, get_args

import typer

from joulebox_server.cli.connection import CommandError, DataOption, JsonOption, WrongUseError, default_data_dir
from joulebox_server.cli.output import print_json, print_table
from joulebox_server.store import Store, upkeep
from joulebox_server.store import tokens as stored
from joulebox_server.store.tokens import Role

PEOPLE = tuple(role for role in get_args(Role) if role != "device")
SECONDS_PER_HOUR = 3600.0

tokens = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Access tokens, made and shut out on the server's machine."
)


@contextmanager
def opened(data: Path | None, *, must_exist: bool = True) -> Iterator[Store]:
    """The store of a data folder. Raises CommandError when it cannot be used."""
    data_dir = data or default_data_dir()
    if must_exist and not (data_dir / "joulebox.db").is_file():
        raise CommandError(f"{data_dir} holds no server's data; give the folder with --data")
    try:
        store = Store(data_dir)
    except (OSError, sqlite3.Error) as error:
        raise CommandError(f"the data folder {data_dir} cannot be used: {error}") from None
    try:
        yield store
    finally:
        store.close()


@tokens.command("create")
def create_token(
    role: Annotated[str, typer.Option(help=f"One of {', '.join(PEOPLE)}.")],
    name: Annotated[str, typer.Option(help="For whom; shown in the list.")] = "",
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a token and print it, this once."""
    if role not in PEOPLE:
        raise WrongUseError(f"a token's role is one of {', '.join(PEOPLE)}, not {role!r}")
    with opened(data, must_exist=False) as store:
        token = store.write(stored.create, role, name or role)  # type: ignore[arg-type]
    if as_json:
        print_json({"token": token, "role": role, "name": name or role})
    else:
        typer.echo(token)


@tokens.command("list")
def list_tokens(data: DataOption = None, as_json: JsonOption = False) -> None:
    """All tokens, without their secrets."""
    with opened(data) as store:
        found = store.read(stored.listed)
    if as_json:
        print_json({"items": found})
        return
    print_table(
        ("id", "name", "role", "made", "revoked"),
        [(t["id"], t["name"], t["role"], t["created_at"], t["revoked_at"]) for t in found],
        "no token yet; `joulebox token create` makes one",
    )


@tokens.command("revoke")
def revoke_token(
    token: Annotated[str, typer.Argument(help="Id or name of a token, not the token itself.")],
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Shut a token out."""
    with opened(data) as store:
        store.write(stored.revoke, token)
    if as_json:
        print_json({"revoked": token})
    else:
        typer.echo(f"token {token} is shut out")


def backup(
    folder: Annotated[Path, typer.Argument(help="Where to; blobs that are there already are not copied again.")],
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Copy the database and every blob, also while the server runs."""
    with opened(data) as store:
        try:
            copied = upkeep.back_up(store, folder)
        except OSError as error:
            raise CommandError(f"the backup to {folder} failed: {error}") from None
    if as_json:
        print_json({"folder": str(folder), "blobs_copied": copied})
    else:
        typer.echo(f"backed up to {folder}: the database and {copied} new blob(s)")


def restore(
    folder: Annotated[Path, typer.Argument(help="A folder that `joulebox backup` filled.")],
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Put a backup into a data folder that holds no server's data yet."""
    data_dir = data or default_data_dir()
    try:
        found = upkeep.restore(folder, data_dir)
    except (OSError, sqlite3.Error) as error:
        raise CommandError(f"the backup in {folder} cannot be restored: {error}") from None
    if as_json:
        print_json({"data": str(data_dir), "blobs_copied": found.blobs, "blobs_missing": found.missing})
        return
    typer.echo(f"restored to {data_dir}: the database and {found.blobs} blob(s)")
    if found.missing:
        typer.echo(
            f"{len(found.missing)} blob(s) of the database are not in the backup: {', '.join(found.missing[:5])}"
        )


def gc(
    grace_hours: Annotated[float, typer.Option(min=0, help="Keep whatever is younger.")] = 24.0,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove blobs that nothing refers to, and uploads that never ended."""
    with opened(data) as store:
        removed = upkeep.collect(store, grace_hours * SECONDS_PER_HOUR)
    if as_json:
        print_json({"blobs_removed": removed})
    else:
        typer.echo(f"{removed} blob(s) removed")
