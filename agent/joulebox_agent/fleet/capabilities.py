"""What this device is and can do, told to the server at every start."""

import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from joulebox_agent import __version__
from joulebox_agent.errors import RendererError
from joulebox_agent.loop import ask_renderer
from joulebox_agent.sources.survey import survey

CPU_INFO = Path("/proc/cpuinfo")
# Levels of the x86-64 psABI, by the flag of each that no lower level has.
X86_LEVELS = (("avx512vl", "x86-64-v4"), ("avx2", "x86-64-v3"), ("sse4_2", "x86-64-v2"))


def describe_device(renderer: Sequence[str], source: str, sysfs_root: Path) -> dict[str, Any]:
    """The body of PUT /devices/{id}/capabilities. Raises RendererError when the renderer does not answer."""
    methods = [
        {
            "method": report.method,
            "available": report.available and (report.method != "replay" or source.startswith("replay")),
            "scope": report.scope,
            "reason": report.reason,
        }
        for _, report in survey(sysfs_root, source)
        if report.this_platform
    ]
    return {
        "platform": platform.platform(),
        "machine": platform.machine(),
        "os": platform.system(),
        "cores": os.cpu_count() or 1,
        "isa": instruction_set(),
        "agent_version": __version__,
        "energy_methods": methods,
        "renderer": describe_renderer(renderer),
    }


def describe_renderer(command: Sequence[str]) -> dict[str, Any]:
    """Name, version and settings schema as the renderer gives them."""
    words = ask_renderer(command, "--version").split()
    if not words:
        raise RendererError(f"{command[0]} --version printed nothing.")
    name = words[0] if len(words) > 1 else Path(command[0]).stem
    schema_text = ask_renderer(command, "schema")
    try:
        schema = json.loads(schema_text)
    except (ValueError, RecursionError) as error:
        raise RendererError(f"{command[0]} schema did not print JSON: {error}.") from error
    if not isinstance(schema, dict):
        raise RendererError(f"{command[0]} schema printed {type(schema).__name__}, not a JSON object.")
    return {"name": name, "version": words[-1], "settings_schema": schema}


def instruction_set() -> str:
    """x86-64-v1 to v4 where the flags can be read, else the machine's name."""
    machine = platform.machine()
    if machine.lower() not in ("x86_64", "amd64"):
        return machine
    try:
        lines = CPU_INFO.read_text().splitlines()
    except OSError:
        return machine
    flags = next((set(line.split(":", 1)[1].split()) for line in lines if line.startswith("flags")), set())
    return next((level for flag, level in X86_LEVELS if flag in flags), "x86-64-v1")
