"""Commands that stand in the container files and the README exist, with every option that they use."""

import functools
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

PROGRAMS = {"joulebox", "joulebox-render", "joulebox-agent"}
ENDS_OF_A_COMMAND = {"&&", "||", ";", "|", "&", "#"}
PREFIXES = {"exec", "$"}


def commands(text: str) -> Iterator[list[str]]:
    """Every joulebox command in a piece of shell, as words."""
    for line in text.replace("\\\n", " ").splitlines():
        command: list[str] = []
        for word in [*shlex.split(line), ";"]:
            if word not in ENDS_OF_A_COMMAND:
                command.append(word)
                continue
            while command and command[0] in PREFIXES:
                command = command[1:]
            if command[:4] == ["docker", "compose", "exec", "server"]:
                command = command[4:]
            if command and Path(command[0]).name in PROGRAMS:
                yield [Path(command[0]).name, *command[1:]]
            command = []


@functools.cache
def help_of(*command: str) -> str | None:
    """What `--help` prints for a command, None when there is no such command."""
    program = Path(sys.executable).with_name(command[0])
    wide = os.environ | {"COLUMNS": "300", "NO_COLOR": "1", "TERM": "dumb"}
    result = subprocess.run(
        [program, *command[1:], "--help"], env=wide, capture_output=True, text=True, encoding="utf-8", timeout=120
    )
    return result.stdout if result.returncode == 0 else None


def problems(command: list[str]) -> list[str]:
    """What a command says that its program does not know."""
    names = [command[0]]
    text = help_of(*names)
    for word in command[1:]:  # descend as long as the words name commands
        if text is None or not re.search(r"\bCOMMAND\b", text) or word.startswith("-"):
            break
        names.append(word)
        text = help_of(*names)
    if text is None:
        return [f"{' '.join(names)}: no such command"]
    options = [word.partition("=")[0] for word in command[len(names) :] if re.match(r"--?[a-zA-Z]", word)]
    return [
        f"{' '.join(names)}: no option {option}"
        for option in options
        if not re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", text)
    ]


@pytest.fixture(scope="module")
def compose(root: Path) -> dict[str, Any]:
    """docker-compose.yml, read as YAML."""
    text = (root / "docker-compose.yml").read_text(encoding="utf-8")
    document: dict[str, Any] = yaml.safe_load(text)
    return document


def shell(value: str | list[str]) -> str:
    """A command of a compose file as shell text."""
    if isinstance(value, str):
        return value
    return value[2] if value[:2] == ["sh", "-c"] else shlex.join(value)


def test_the_server_and_its_agents_find_each_other(compose: dict[str, Any]) -> None:
    services = compose["services"]
    agents = [name for name in services if name.startswith("agent")]
    assert len(agents) == 2
    assert len({services[name]["environment"]["DEVICE"] for name in agents}) == 2
    for name in agents:
        text = shell(services[name]["command"])
        assert services[name]["depends_on"]["server"]["condition"] == "service_healthy"
        assert "--server http://server:8473" in text
        assert "run --source replay" in text
    mounted = {volume.partition(":")[0] for name in services for volume in services[name]["volumes"]}
    assert set(compose["volumes"]) == {volume for volume in mounted if not volume.startswith(".")}


def test_the_secret_is_a_file_that_every_service_reads_where_it_is_mounted(compose: dict[str, Any]) -> None:
    (name,) = compose["secrets"]
    assert compose["secrets"][name] == {"file": "./secrets/enrollment.txt"}
    for service in compose["services"].values():
        assert service["secrets"] == [name]
        assert f"/run/secrets/{name}" in shell(service["command"])


def test_a_server_beyond_loopback_is_protected_and_published_to_this_machine_alone(compose: dict[str, Any]) -> None:
    server = compose["services"]["server"]
    assert "--host 0.0.0.0" in shell(server["command"])
    assert "--enrollment-secret-file" in shell(server["command"])
    assert server["ports"] == ["127.0.0.1:8473:8473"]


def test_compose_uses_commands_that_exist(root: Path, compose: dict[str, Any]) -> None:
    services = compose["services"].values()
    text = [shell(service["command"]) for service in services]
    text += [shell(service["healthcheck"]["test"]) for service in services if "healthcheck" in service]
    comments = re.findall(r"^#   (.+)$", (root / "docker-compose.yml").read_text(encoding="utf-8"), re.MULTILINE)
    found = list(commands("\n".join(text + comments)))
    assert len(found) >= 6
    assert [problem for command in found for problem in problems(command)] == []


def test_the_image_uses_commands_that_exist(root: Path) -> None:
    text = (root / "Dockerfile").read_text(encoding="utf-8")
    run = re.findall(r"^RUN (.+)$", text.replace("\\\n", " "), re.MULTILINE)
    final = re.findall(r"^CMD (\[.+\])$", text, re.MULTILINE)
    found = list(commands("\n".join(run + [shlex.join(yaml.safe_load(words)) for words in final])))
    assert len(found) == 2
    assert [problem for command in found for problem in problems(command)] == []


def test_the_image_copies_what_is_there_and_not_ignored(root: Path) -> None:
    sources = re.findall(r"^COPY (\S+) ", (root / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    kept = re.findall(r"^!(\S+)$", (root / ".dockerignore").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(sources) == sorted(kept)
    assert [source for source in sources if not (root / source).exists()] == []


def test_the_readme_uses_commands_that_exist(root: Path) -> None:
    text = (root / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    found = list(commands("\n".join(blocks)))
    assert len(found) >= 5
    assert [problem for command in found for problem in problems(command)] == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("joulebox sevre --port 1", "joulebox sevre: no such command"),
        ("x && .venv/bin/joulebox-agent enroll --sever http://a", "joulebox-agent enroll: no option --sever"),
        ("joulebox device enrol --json", "joulebox device enrol: no such command"),
    ],
)
def test_a_misspelt_command_is_caught(text: str, problem: str) -> None:
    assert [found for command in commands(text) for found in problems(command)] == [problem]
