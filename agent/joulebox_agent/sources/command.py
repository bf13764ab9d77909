"""A short command run for what it prints: bounded in time and in size, never through a shell."""

import errno
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Sequence

LONGEST = 1 << 20  # bytes of output; a plist of a battery has some 20 kB
TIME_LIMIT_S = 5.0
SHOWN = 200

Ask = Callable[[], bytes]


def run_command(words: Sequence[str], time_limit_s: float = TIME_LIMIT_S) -> bytes:
    """What the command prints. Raises OSError (its `filename` the program) when it cannot be started, fails,
    takes longer than the limit or prints more than a megabyte; then it is ended with all it started."""
    name = words[0]
    try:
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
        )
    except (OSError, ValueError) as error:
        text = getattr(error, "strerror", None) or str(error)
        raise OSError(getattr(error, "errno", None) or errno.EINVAL, f"cannot be started: {text}", name) from error
    said: dict[int, bytes] = {}
    too_much = threading.Event()

    def drain(number: int) -> None:
        pipe = (process.stdout, process.stderr)[number]
        assert pipe is not None
        said[number] = pipe.read(LONGEST + 1)
        if len(said[number]) > LONGEST:
            too_much.set()
            _end(process)

    readers = [threading.Thread(target=drain, args=(number,), daemon=True) for number in (0, 1)]
    for reader in readers:
        reader.start()
    try:
        process.wait(time_limit_s)
        for reader in readers:  # a grandchild may hold the pipe open
            reader.join(time_limit_s)
        late = any(reader.is_alive() for reader in readers)
    except subprocess.TimeoutExpired:
        late = True
    finally:
        _end(process)
        process.wait()
        for reader, pipe in zip(readers, (process.stdout, process.stderr), strict=True):
            reader.join(1.0)  # what left the process group may hold a pipe open for ever
            if pipe is not None and not reader.is_alive():
                pipe.close()
    if too_much.is_set():
        raise OSError(errno.EMSGSIZE, f"printed more than {LONGEST} bytes", name)
    if late:
        raise OSError(errno.ETIMEDOUT, f"did not answer within {time_limit_s:g} s", name)
    if process.returncode:
        last = said.get(1, b"").decode(errors="replace").strip().splitlines()[-1:]
        words_of_it = f": {last[0][:SHOWN]}" if last else ""
        raise OSError(errno.EIO, f"left with code {process.returncode}{words_of_it}", name)
    return said.get(0, b"")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends the command and, where the system has process groups, whatever it started."""
    try:
        if os.name == "nt":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
