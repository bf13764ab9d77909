"""Errors of the server distribution; problems.py maps each kind to an HTTP status, nothing else does."""

from collections.abc import Sequence
from dataclasses import dataclass


class ServerError(Exception):
    """Base of every error that a user of the server sees as one sentence."""


@dataclass(frozen=True)
class FieldError:
    """One thing wrong with the input: `field` is its path, such as `axes.gather_count[1]`."""

    field: str
    message: str


class InvalidError(ServerError):
    """Input that is understood but cannot be used; `errors` names every field at fault."""

    def __init__(self, message: str, errors: Sequence[FieldError] = ()) -> None:
        super().__init__(message)
        self.errors = tuple(errors)


class DigestError(InvalidError):
    """Bytes that do not hash to the name they were sent under."""


class UnauthenticatedError(ServerError):
    """No token, or one that is not known or was revoked."""


class ForbiddenError(ServerError):
    """A good token whose role may not do this."""


class NotFoundError(ServerError):
    """Nothing here has this name or id."""


class ConflictError(ServerError):
    """The request contradicts what is stored."""


class PreconditionError(ServerError):
    """The If-Match header names a state that is no more."""


class TooManyError(ServerError):
    """Asked more often than this server answers; `retry_after_s` says when to ask again."""

    def __init__(self, message: str, retry_after_s: int) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class TooLargeError(ServerError):
    """More bytes, jobs or files than this server accepts."""


class StorageFullError(ServerError):
    """The disk under the data folder has no room left; nothing was stored."""


class UnavailableError(ServerError):
    """The server cannot do this now and can later."""
