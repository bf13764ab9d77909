"""Everything this renderer raises on purpose: one sentence that says what was wrong, where, and what would be right."""


class RenderError(Exception):
    """Base of all errors a user can cause or meet; the command line prints its text and exits with `exit_code`."""

    exit_code = 1


class SceneError(RenderError):
    """The scene file, one of its meshes or a path in it cannot be used."""

    exit_code = 2


class SettingsError(RenderError):
    """A setting is unknown, malformed or out of range."""

    exit_code = 2


class TargetError(RenderError):
    """A file that the user named for a result cannot be written there."""

    exit_code = 2


class StoppedError(RenderError):
    """Rendering was given up because somebody asked for it."""


class ImageError(RenderError):
    """A picture cannot be read or written."""
