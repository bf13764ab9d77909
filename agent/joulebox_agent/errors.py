"""Everything the agent raises on purpose: one sentence on what was wrong, where, and what would be right.

The command line prints the text of an AgentError and leaves with its `exit_code`: 1 failed, 2 wrong use.
"""


class AgentError(Exception):
    """Base of all errors a user can cause or meet."""

    exit_code = 1


class UsageError(AgentError):
    """An argument, a file or a setting given by the user cannot be used."""

    exit_code = 2


class SourceUnavailableError(AgentError):
    """The asked energy source cannot be read on this machine; the text carries the remedy."""


class ChargingError(AgentError):
    """The battery cannot be charged as planned: the hook failed."""


class RendererError(AgentError):
    """The renderer died, hung, or wrote something that is not the loop protocol."""


class RendererRefusedError(RendererError):
    """The renderer left with code 2: it does not accept the scene or the settings."""

    exit_code = 2


class ServerUnreachableError(AgentError):
    """No answer, or an answer that asks to try again later (5xx, 429). Nothing is lost; try again."""


class TokenRejectedError(AgentError):
    """The server does not know this device's token (wrong or revoked)."""


class ServerRefusedError(AgentError):
    """The server understood and said no; trying the same again cannot help.

    status  HTTP status
    code    the `code` of the problem document, or ""
    """

    def __init__(self, message: str, status: int, code: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.code = code


class BundleError(AgentError):
    """A scene bundle is not a zip that can be unpacked safely."""


class SpoolFullError(AgentError):
    """The disk that holds the spool has no room left."""
