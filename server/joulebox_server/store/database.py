"""The SQLite database: one writer thread with group commit, a read connection for every read under way."""

import queue
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, InvalidError, PreconditionError, StorageFullError, UnavailableError
from joulebox_server.store.migrations import migrations

DATABASE = "joulebox.db"
BUSY_TIMEOUT_MS = 5000
LONGEST_LOG_PAGES = 20_000
"""At which the writer itself moves its log into the database (80 MB); `checkpoint` does it long before."""
LARGEST_GROUP = 64
"""Most writes that share one commit, so that the first of them does not wait for long."""

Row = dict[str, Any]
P = ParamSpec("P")
T = TypeVar("T")


def rows(db: Database, sql: str, parameters: Iterable[Any] = ()) -> list[Row]:
    """All rows of a query as dictionaries."""
    cursor = db.conn.execute(sql, tuple(parameters))
    names = [column[0] for column in cursor.description]
    return [dict(zip(names, values, strict=True)) for values in cursor]


def row(db: Database, sql: str, parameters: Iterable[Any] = ()) -> Row | None:
    """The first row of a query, or None."""
    return next(iter(rows(db, sql, parameters)), None)


def insert(db: Database, table: str, values: Row) -> None:
    """Add one row; `values` names its columns, in the code's own words."""
    places = ", ".join("?" * len(values))
    db.conn.execute(f"INSERT INTO {table} ({', '.join(values)}) VALUES ({places})", tuple(values.values()))


def number(db: Database, sql: str, parameters: Iterable[Any] = ()) -> int:
    """The one integer that a query answers; 0 for NULL."""
    return int(db.execute(sql, tuple(parameters)).fetchone()[0] or 0)


def etag(version: int) -> str:
    """The ETag of something that an operator can change, after so many changes."""
    return f'"v{version}"'


def check_match(wanted: str | None, version: int, what: str) -> None:
    """Raise PreconditionError unless the If-Match header `wanted` (None: not sent) names this version."""
    if wanted is not None and wanted.strip() != "*" and etag(version) not in [tag.strip() for tag in wanted.split(",")]:
        raise PreconditionError(
            f"{what} was changed meanwhile: its ETag is {etag(version)} and not {wanted}; read it again"
        )


class _Write:
    """One function waiting for the writer thread, and the future of what it returns."""

    def __init__(self, function: Callable[[Database], Any]) -> None:
        self.function = function
        self.future: Future[Any] = Future()
        self.result: Any = None
        self.error: Exception | None = None

    def run(self, db: Database) -> None:
        """Run inside a savepoint of the open transaction; an error undoes this write alone."""
        # Not `db.atomic()`: under its random names SQLite would compile three statements anew for every write.
        db.conn.execute("SAVEPOINT one_write")
        try:
            self.result = self.function(db)
        except Exception as error:
            self.error = _named(error)
            if db.conn.in_transaction:  # a full disk ends the whole transaction
                db.conn.execute("ROLLBACK TO one_write")
        if db.conn.in_transaction:
            db.conn.execute("RELEASE one_write")

    def settle(self) -> None:
        if self.error is None:
            self.future.set_result(self.result)
        else:
            self.future.set_exception(self.error)


class Store:
    """A data folder: `joulebox.db`, `blobs/` and `incoming/`.

    Raises sqlite3.Error or OSError when the folder cannot be used. `close()` when done.
    """

    def __init__(self, data_dir: Path) -> None:
        self.blob_dir = data_dir / "blobs"
        self.incoming_dir = data_dir / "incoming"
        for folder in (self.blob_dir, self.incoming_dir):
            folder.mkdir(parents=True, exist_ok=True)
        self.path = data_dir / DATABASE
        self.last_event_id = 0
        self._listeners: list[Callable[[], None]] = []
        self._queue: queue.SimpleQueue[_Write | None] = queue.SimpleQueue()
        self._closed = False
        self._lock = threading.Lock()
        self._read_ended = threading.Condition(self._lock)
        self._reading = 0
        self._idle_readers: list[Database] = []
        self._writer_db = self._prepared()
        self._writer = threading.Thread(target=self._write_loop, name="joulebox-store-writer", daemon=True)
        self._writer.start()

    def write(self, function: Callable[Concatenate[Database, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run `function(db, ...)` in a write transaction; returns once it is on the disk.

        Raises what the function raises (its changes undone), StorageFullError when the disk is full.
        """
        return self.submit(function, *args, **kwargs).result()

    def submit(self, function: Callable[Concatenate[Database, P], T], *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        """As `write`, without waiting."""
        write = _Write(lambda db: function(db, *args, **kwargs))
        with self._lock:
            if self._closed:
                raise UnavailableError("the store is closed")
            self._queue.put(write)
        return write.future

    def read(self, function: Callable[Concatenate[Database, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run `function(db, ...)` on a read-only connection that this thread has to itself, over one snapshot."""
        with self._reader() as db:
            db.conn.execute("BEGIN")
            try:
                return function(db, *args, **kwargs)
            except sqlite3.Error as error:
                raise _named(error) from error
            finally:
                db.conn.execute("ROLLBACK")

    def look(self, function: Callable[Concatenate[Database, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """As `read`, for a function that runs one query: a third of the statements."""
        with self._reader() as db:
            try:
                return function(db, *args, **kwargs)
            except sqlite3.Error as error:
                raise _named(error) from error

    def checkpoint(self) -> None:
        """Move what was committed from the log into the database, beside the writer and without holding it up.

        A writer that did it on its own would make whoever waits for its commit wait for two more disk writes.
        """
        with self._reader() as db:
            db.conn.execute("PRAGMA query_only=OFF")
            try:
                db.conn.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
            finally:
                db.conn.execute("PRAGMA query_only=ON")

    def on_event(self, listener: Callable[[], None]) -> None:
        """Call `listener()` on the writer thread after every commit that added an event."""
        self._listeners.append(listener)

    def close(self) -> None:
        """Finish the writes that wait and the reads under way, then close every connection."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._queue.put(None)
        self._writer.join()
        with self._read_ended:
            # Closing a connection in the middle of its query ends the whole process with a segmentation fault.
            self._read_ended.wait_for(lambda: self._reading == 0)
        for db in [*self._idle_readers, self._writer_db]:
            db.conn.close()

    def _prepared(self) -> Database:
        db = self._connect()
        db.conn.execute("PRAGMA journal_mode=WAL")
        db.conn.execute(f"PRAGMA wal_autocheckpoint={LONGEST_LOG_PAGES}")
        # Off while tables are rebuilt: dropping the old one would take along every row that refers to it.
        db.conn.execute("PRAGMA foreign_keys=OFF")
        # FULL: an agent deletes its spooled result on our word, so the word must survive a power cut.
        db.conn.execute("PRAGMA synchronous=FULL")
        # Immediate, so that two processes opening a new folder at once do not both make the tables.
        db.conn.execute("BEGIN IMMEDIATE")
        migrations.apply(db)
        db.conn.execute("COMMIT")
        db.conn.execute("PRAGMA foreign_keys=ON")
        self.last_event_id = _newest_event(db)
        return db

    def _connect(self) -> Database:
        # Closed by `close()`, which another thread calls; each is used by one thread at a time.
        connection = sqlite3.connect(
            self.path, timeout=BUSY_TIMEOUT_MS / 1000, isolation_level=None, check_same_thread=False
        )
        connection.execute("PRAGMA foreign_keys=ON")
        return Database(connection)

    @contextmanager
    def _reader(self) -> Iterator[Database]:
        """A connection for one read. They are kept for the next: threads come and go, connections need not."""
        with self._lock:
            if self._closed:
                raise UnavailableError("the store is closed")
            self._reading += 1
            db = self._idle_readers.pop() if self._idle_readers else None
        try:
            if db is None:
                db = self._connect()
                db.conn.execute("PRAGMA query_only=ON")
            yield db
        finally:
            with self._read_ended:
                self._reading -= 1
                if db is not None:
                    self._idle_readers.append(db)
                self._read_ended.notify_all()

    def _write_loop(self) -> None:
        while (first := self._queue.get()) is not None:
            group = [first]
            ended = False
            while len(group) < LARGEST_GROUP and not self._queue.empty():
                following = self._queue.get()
                if following is None:
                    ended = True
                    break
                group.append(following)
            self._commit(group)
            if ended:
                return

    def _commit(self, waiting: list[_Write]) -> None:
        # Whoever asked may have gone; those who have not can no longer go before their answer.
        group = [write for write in waiting if write.future.set_running_or_notify_cancel()]
        db = self._writer_db
        try:
            # A plain BEGIN would read first and fail with "database is locked" when another process wrote.
            db.conn.execute("BEGIN IMMEDIATE")
            for write in group:
                write.run(db)
                if write.error is not None and not db.conn.in_transaction:
                    raise write.error  # a full disk undoes the whole transaction, the writes before too
            newest = _newest_event(db)
            db.conn.execute("COMMIT")
        except Exception as error:
            db.rollback()
            for write in group:
                write.error = write.error or _named(error)
            newest = self.last_event_id
        announce = newest > self.last_event_id
        self.last_event_id = newest
        for write in group:
            write.settle()
        if announce:
            for listener in self._listeners:
                listener()


def _newest_event(db: Database) -> int:
    return number(db, "SELECT max(id) FROM event")


def _named(error: Exception) -> Exception:
    """SQLite's errors that a user can do something about, as ours; anything else as it is."""
    if isinstance(error, OverflowError | UnicodeEncodeError):
        return InvalidError(f"a value is too large or no text that can be stored: {error}")
    if isinstance(error, sqlite3.IntegrityError):
        return ConflictError(f"that contradicts what is stored ({error})")
    if isinstance(error, sqlite3.OperationalError):
        if "full" in str(error):
            return StorageFullError("the server's disk is full; free some space and send it again")
        if "locked" in str(error) or "busy" in str(error):
            return UnavailableError("another process holds the database; try again in a moment")
    return error
