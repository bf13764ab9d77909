"""Settings of one server, built at the entry point and passed down; nothing reads the environment."""

import ipaddress
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

MEBIBYTE = 1 << 20


class ServerSettings(BaseModel):
    """What a server needs to know; frozen, every quantity with its unit."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    data_dir: Path
    host: str = "127.0.0.1"
    port: int = Field(default=8473, ge=0, le=65535)
    anonymous_reads: bool = True
    """Reads without a token, as a viewer; has an effect on loopback only."""
    enrollment_secret: str | None = Field(default=None, min_length=16, repr=False)
    """Shared secret that enrols any number of devices, as a one-time code enrols one."""
    secure: bool = False
    """Speaks TLS itself."""
    wheels_dir: Path | None = None
    """Folder of the wheels that devices install the agent and the renderer from."""
    workers: int = Field(default=1, ge=1, le=64)
    """Processes that compare pictures."""
    lease_slack_s: FiniteFloat = Field(default=300.0, gt=0)
    """Added to the longest time a measurement may take: start, compile, upload."""
    release_pause_s: FiniteFloat = Field(default=5.0, ge=0)
    """A job given back unmeasured is not handed out again sooner."""
    retry_pause_s: FiniteFloat = Field(default=5.0, ge=0)
    """A job that failed once is not handed out again sooner; the pause doubles with each failure."""
    longest_retry_pause_s: FiniteFloat = Field(default=300.0, ge=0)
    reap_every_s: FiniteFloat = Field(default=5.0, gt=0)
    max_attempts: int = Field(default=3, ge=1)
    suspect_after: int = Field(default=5, ge=1)
    """Failures in a row that are its own, after which a device gets no jobs until an operator clears it."""
    max_configurations: int = Field(default=2000, ge=1)
    max_jobs: int = Field(default=20_000, ge=1)
    """Most jobs of one sweep."""
    max_body_bytes: int = Field(default=16 * MEBIBYTE, ge=1024)
    """Longest JSON body."""
    body_silence_s: FiniteFloat = Field(default=30.0, gt=0)
    """A body of which nothing came for so long is given up."""
    max_blob_bytes: int = Field(default=512 * MEBIBYTE, ge=1024)
    max_scene_files: int = Field(default=500, ge=1)
    max_scene_bytes: int = Field(default=512 * MEBIBYTE, ge=1024)
    """Longest scene once unpacked."""

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        return is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Whether a host name or address means this machine alone."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
