"""The one exception that the analysis raises for input it cannot use."""

from joulebox_server.errors import ServerError


class AnalysisError(ServerError):
    """Input that cannot be analysed; the message is one sentence for the user."""
