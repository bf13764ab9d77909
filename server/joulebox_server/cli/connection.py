"""How commands reach a server: the options that all of them share, and errors as one sentence."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import httpx2
import typer
from platformdirs import user_data_path

from joulebox_server.errors import InvalidError, ServerError

DEFAULT_URL = "http://127.0.0.1:8473"
ADDRESS_FILE = "server.json"
TOKEN_FILE = "operator.token"
TIMEOUT_S = 60.0
CONNECT_TIMEOUT_S = 5.0

ServerOption = Annotated[
    str | None,
    typer.Option("--server", envvar="JOULEBOX_SERVER", help="Address of the server.", show_default=DEFAULT_URL),
]
TokenOption = Annotated[
    str | None,
    typer.Option("--token", envvar="JOULEBOX_TOKEN", help="Access token.", show_default="the local server's"),
]
DataOption = Annotated[
    Path | None,
    typer.Option("--data", envvar="JOULEBOX_DATA", help="Data folder of the server.", show_default="per user"),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document.")]


class CommandError(ServerError):
    """A command failed for a reason that the user can read: exit code 1."""


class WrongUseError(InvalidError):
    """What the user gave cannot be used: exit code 2."""


class UnreachableError(CommandError):
    """Nobody answers at the server's address."""


def default_data_dir() -> Path:
    """Where a server keeps its data unless told otherwise."""
    return user_data_path("joulebox") / "server"


@dataclass(frozen=True)
class Connection:
    """A server's address and the token to show it."""

    url: str
    token: str | None

    def request(self, method: str, path: str, **options: Any) -> httpx2.Response:
        """Ask the server. Raises CommandError or WrongUseError with the server's own sentence."""
        with self.opened() as client:
            return checked(client.request(method, f"/v1{path}", **options))

    def json(self, method: str, path: str, **options: Any) -> Any:
        """As `request`; the document in the answer."""
        return self.request(method, path, **options).json()

    @contextmanager
    def opened(self) -> Iterator[httpx2.Client]:
        """A client to ask several things; being cut off becomes UnreachableError."""
        headers = {} if self.token is None else {"Authorization": f"Bearer {self.token}"}
        timeout = httpx2.Timeout(TIMEOUT_S, connect=CONNECT_TIMEOUT_S)
        try:
            with httpx2.Client(base_url=self.url, headers=headers, timeout=timeout) as client:
                yield client
        except (httpx2.InvalidURL, httpx2.UnsupportedProtocol) as error:
            raise WrongUseError(f"{self.url!r} is not an address like {DEFAULT_URL}: {error}") from None
        except httpx2.TimeoutException:
            raise UnreachableError(f"the server at {self.url} does not answer in time") from None
        except httpx2.TransportError as error:
            raise UnreachableError(
                f"no server answers at {self.url} ({error}); start one with `joulebox serve`, or give --server"
            ) from None


def named(key: str) -> str:
    """A name or id as one part of a path, whatever letters it has: `a?b` is another sweep than `a`.

    Raises WrongUseError for what can be neither.
    """
    if key in ("", ".", "..") or "/" in key:  # servers read %2F as a slash
        raise WrongUseError(f"{key!r} is neither a name nor an id")
    return quote(key, safe="")


def checked(response: httpx2.Response) -> httpx2.Response:
    """The response if it is good. Raises WrongUseError for what the server finds unusable, else CommandError."""
    if response.is_success:
        return response
    try:
        told = response.json()
        detail = str(told["detail"])
    except (ValueError, KeyError, TypeError):
        raise CommandError(
            f"{response.request.url} answered {response.status_code}; is this a joulebox server?"
        ) from None
    if response.status_code in (400, 413, 422):
        raise WrongUseError(detail)
    raise CommandError(detail)


def connect(server: str | None, token: str | None, data: Path | None = None) -> Connection:
    """The connection that the options mean.

    Without --server, the address that the server of this data folder wrote. The token which that server wrote
    is shown to it alone, never to another address.
    """
    data_dir = data or default_data_dir()
    local_url = _address(data_dir)
    url = (server or local_url or DEFAULT_URL).rstrip("/")
    if token is None and url == (local_url or DEFAULT_URL).rstrip("/"):
        token = _read(data_dir / TOKEN_FILE)
    return Connection(url, token)


def write_private(path: Path, text: str) -> None:
    """Write a file that only its owner can read."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text)


def _address(data_dir: Path) -> str | None:
    text = _read(data_dir / ADDRESS_FILE)
    try:
        return None if text is None else str(json.loads(text)["url"])
    except (ValueError, KeyError, TypeError):
        return None


def _read(path: Path) -> str | None:
    try:
        return path.read_text().strip() or None
    except OSError:
        return None
