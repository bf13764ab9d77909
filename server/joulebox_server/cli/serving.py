"""A server as a process: settings checked, port taken, tokens made, uvicorn run, address told."""

import errno
import gc
import json
import logging
import os
import socket
import sqlite3
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from logging.handlers import RotatingFileHandler
from pathlib import Path

import typer
import uvicorn
from fastapi import FastAPI
from pydantic import ValidationError

from joulebox_server.app import create_app
from joulebox_server.cli.connection import (
    ADDRESS_FILE,
    TOKEN_FILE,
    CommandError,
    WrongUseError,
    write_private,
)
from joulebox_server.cli.holding import held
from joulebox_server.cli.output import print_json
from joulebox_server.connections import PatientProtocol, raise_file_limit
from joulebox_server.problems import field_errors
from joulebox_server.settings import ServerSettings, is_loopback
from joulebox_server.store import Store, tokens

GRACE_S = 3
"""How long open requests may take to end after Ctrl-C."""
YOUNG_OBJECTS = 10_000
"""New objects after which Python looks for circles among them; requests under way are more than its usual 700."""
LONGEST_LOG_BYTES = 10 << 20
OLD_LOGS = 3


@dataclass(frozen=True)
class Asked:
    """What the command was given."""

    data_dir: Path
    host: str
    port: int
    secret_file: Path | None
    tls_certificate: Path | None
    tls_key: Path | None
    wheels_dir: Path
    request_log: Path
    workers: int


def run_server(asked: Asked, as_json: bool) -> None:
    """Run a server until Ctrl-C. Raises CommandError or WrongUseError when it cannot start."""
    _check_tls(asked)
    settings = _settings(asked)
    listening = _bind(asked.host, asked.port)
    try:
        with held(settings.data_dir):
            token = _first_token(settings)
            with request_log(asked.request_log):
                _run(asked, settings, listening, token, as_json)
    finally:
        listening.close()


def _run(asked: Asked, settings: ServerSettings, listening: socket.socket, token: str | None, as_json: bool) -> None:
    scheme = "https" if settings.secure else "http"
    url = f"{scheme}://{_host_in_url(asked.host)}:{listening.getsockname()[1]}"
    raise_file_limit()
    app = create_app(settings)
    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        http=PatientProtocol,
        timeout_graceful_shutdown=GRACE_S,
        server_header=False,
        ssl_certfile=asked.tls_certificate,
        ssl_keyfile=asked.tls_key,
    )
    server = _Server(config, app, lambda: _announce(settings, url, token, as_json))
    try:
        server.run(sockets=[listening])
    except KeyboardInterrupt:
        pass  # asked for, and everything is closed
    finally:
        (settings.data_dir / ADDRESS_FILE).unlink(missing_ok=True)
    if not server.started:
        raise CommandError("the server could not start; the lines above say why")


def _check_tls(asked: Asked) -> None:
    """Raises WrongUseError unless both files or none are given, and they belong together."""
    if (asked.tls_certificate is None) != (asked.tls_key is None):
        raise WrongUseError("--tls-certificate and --tls-key belong together; give both or neither")
    if asked.tls_certificate is None:
        return
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(asked.tls_certificate, asked.tls_key, password="")
    except OSError as error:  # ssl.SSLError is one
        raise WrongUseError(
            f"the certificate {asked.tls_certificate} and the key {asked.tls_key} cannot be used: {error}"
        ) from None


@contextmanager
def request_log(path: Path) -> Iterator[None]:
    """Write one JSON line a request to a file that is renewed at 10 MiB, or to standard error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler: logging.Handler = logging.StreamHandler() if str(path) == "-" else _RequestLog(path)
    except OSError as error:
        raise CommandError(f"the request log {path} cannot be written: {error.strerror}") from None
    log = logging.getLogger("joulebox.requests")
    log.setLevel(logging.INFO)
    log.propagate = False
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        handler.close()


class _RequestLog(RotatingFileHandler):
    """Counts what it writes. The library's own asks the file system five times a line how long the file is."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, backupCount=OLD_LOGS, encoding="ascii")
        self._size_bytes = path.stat().st_size
        self._regular = path.is_file()

    def shouldRollover(self, record: logging.LogRecord) -> bool:  # noqa: N802 (the library's name)
        line_bytes = len(record.getMessage()) + 1
        full = self._regular and self._size_bytes + line_bytes > LONGEST_LOG_BYTES
        self._size_bytes = line_bytes if full else self._size_bytes + line_bytes
        return full


class _Server(uvicorn.Server):
    """Says when it listens, and sends home whoever waits for events as soon as it is told to stop."""

    def __init__(self, config: uvicorn.Config, app: FastAPI, on_start: Callable[[], None]) -> None:
        super().__init__(config)
        self._app = app
        self._on_start = on_start

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            # What is loaded now stays: without this every full collection walks through all libraries again.
            gc.collect()
            gc.freeze()
            gc.set_threshold(YOUNG_OBJECTS)
            self._on_start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._app.state.services.bell.close()
        await super().shutdown(sockets)
        gc.unfreeze()  # what is frozen is not freed, and a library that counts its objects says so at the end


def _secret(path: Path) -> str:
    try:
        return path.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise WrongUseError(f"the enrolment secret cannot be read from {path}: {error}") from None


def _settings(asked: Asked) -> ServerSettings:
    try:
        return ServerSettings(
            data_dir=asked.data_dir,
            host=asked.host,
            port=asked.port,
            enrollment_secret=None if asked.secret_file is None else _secret(asked.secret_file),
            workers=asked.workers,
            secure=asked.tls_certificate is not None,
            wheels_dir=asked.wheels_dir,
        )
    except ValidationError as error:
        wrong = field_errors(error.errors(include_input=False))[0]
        raise WrongUseError(f"{wrong.field.replace('_', ' ')}: {wrong.message}") from None


def _bind(host: str, port: int) -> socket.socket:
    """The listening socket, taken before anything else so that a taken port leaves no trace."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host.strip("[]"), port))
        listening.listen(2048)
        listening.set_inheritable(True)
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            raise CommandError(f"port {port} at {host} is taken; stop what uses it or give another --port") from None
        raise CommandError(f"cannot listen at {host} port {port}: {error.strerror or error}") from None
    return listening


def _first_token(settings: ServerSettings) -> str | None:
    """The operator token if this is the first start, and nothing at a later one.

    Beyond loopback a server must have been given tokens, or an enrolment secret as a sign that it is meant.
    """
    try:
        store = Store(settings.data_dir)
    except (OSError, sqlite3.Error) as error:
        raise CommandError(f"the data folder {settings.data_dir} cannot be used: {error}") from None
    try:
        first = store.read(tokens.people_count, valid=False) == 0
        if not settings.loopback:
            meant = first and settings.enrollment_secret is not None
            if not meant and store.read(tokens.people_count, valid=True) == 0:
                raise CommandError(
                    f"no token protects this server, so it listens on loopback only and not at {settings.host}; "
                    "make one with `joulebox token create --role operator` first"
                )
        if not first:
            return None
        token = store.write(tokens.create, "operator", "first start")
        write_private(settings.data_dir / TOKEN_FILE, token + "\n")
        return token
    finally:
        store.close()


def _announce(settings: ServerSettings, url: str, token: str | None, as_json: bool) -> None:
    # Others reach it by the machine's name, this machine by loopback.
    local_url = url if not _is_any(settings.host) else url.replace(_host_in_url(settings.host), "127.0.0.1")
    write_private(settings.data_dir / ADDRESS_FILE, json.dumps({"url": local_url, "pid": os.getpid()}))
    if as_json:
        print_json({"url": local_url, "data": str(settings.data_dir), "operator_token": token})
    else:
        typer.echo(f"joulebox serves at {local_url} (data in {settings.data_dir}); Ctrl-C ends it")
        if token is not None:
            typer.echo(f"operator token, shown this once: {token}")
    if not is_loopback(settings.host) and not as_json:
        typer.echo("anybody who reaches this address needs a token; reads from here do too")


def _is_any(host: str) -> bool:
    return host.strip("[]") in ("0.0.0.0", "::")


def _host_in_url(host: str) -> str:
    return f"[{host}]" if ":" in host and not host.startswith("[") else host
