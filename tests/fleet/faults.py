"""Random faults, round after round, and what must hold after each: `make test-fleet`.

    python faults.py [--rounds 200] [--seed N]

Every round does one thing to a running server and agent at a random moment, lets them recover, and then asks the
database: is every result that an agent had safe in its spool there exactly once, is no job leased twice, is the
database whole? Prints a line for each kind of fault; ends with exit code 1 and the seed when something is wrong.
"""

import argparse
import contextlib
import hashlib
import random
import socket
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "server")]

from faulty_world import Faults, forked, kill, measure_and_deliver, serve, wire  # noqa: E402
from joulebox_server.store import Store  # noqa: E402
from seeded import add_devices, add_scene, add_sweep  # noqa: E402

LOOKS, LOOK_EVERY_S = 800, 0.05
"""How long a recovery may take. Counted, not timed: what stops this process for a while stops the others too."""
JOBS = 1000
"""Of each sweep; a new one begins when few are left."""


class BrokenError(Exception):
    """Something that must never happen."""


class World:
    """Server, agent and wire over one data folder."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.chance = random.Random(seed)
        self.data, self.state, self.ledger = folder / "data", folder / "spool", folder / "ledger"
        self.ledger.touch()
        self.faults = Faults(folder / "faults.json")
        self.faults.set()
        store = Store(self.data)
        add_scene(store)
        (self.device,) = add_devices(store, 1)
        store.close()
        self.sweeps = 0
        self.server_port, self.port = free_ports()
        self.spoilt: set[str] = set()
        """Attempts whose spooled file was damaged: they may be missing."""
        self.server = self.agent = self.wire = 0

    def add_work(self) -> None:
        """A sweep more, when few jobs are left. As an operator would: beside the running server."""
        with self.database() as db:
            left = db.execute("SELECT count(*) FROM job WHERE state IN ('queued', 'leased')").fetchone()[0]
        if left < JOBS // 4:
            store = Store(self.data)
            self.sweeps += 1
            add_sweep(store, f"sweep {self.sweeps}", [self.device], JOBS)
            store.close()

    def start_server(self) -> None:
        self.server = forked(lambda: serve(self.data, self.server_port, self.faults))

    def start_agent(self) -> None:
        url, seed = f"http://127.0.0.1:{self.port}", self.chance.randrange(10**9)
        self.agent = forked(lambda: measure_and_deliver(url, self.device, self.state, self.ledger, self.faults, seed))

    def start(self) -> None:
        seed = self.chance.randrange(10**9)
        self.wire = forked(lambda: wire(self.port, self.server_port, self.faults, seed))
        self.start_server()
        self.start_agent()

    def stop(self) -> None:
        for pid in (self.agent, self.wire, self.server):
            if pid:
                kill(pid)

    @contextlib.contextmanager
    def database(self) -> Iterator[sqlite3.Connection]:
        connection = sqlite3.connect(self.data / "joulebox.db", timeout=20, isolation_level=None)
        try:
            yield connection
        finally:
            connection.close()

    def measured(self) -> dict[str, str]:
        """Pixel hash of each attempt that the agent had safe."""
        lines = self.ledger.read_text().splitlines()
        whole = [line.split() for line in lines if len(line.split()) == 2 and len(line.split()[1]) == 64]
        return {line[0]: line[1] for line in whole}

    def check(self, progress: int) -> int:
        """Wait until the measured is stored and `progress` more beside; returns how many results there are."""
        expected = {attempt: pixels for attempt, pixels in self.measured().items() if attempt not in self.spoilt}
        for _ in range(LOOKS):
            with self.database() as db:
                found = db.execute("SELECT attempt_id, pixel_sha256 FROM result").fetchall()
            stored, count = dict(found), len(found)
            missing = expected.keys() - stored.keys()
            if not missing and count >= progress:
                break
            time.sleep(LOOK_EVERY_S)
        else:
            raise BrokenError(f"{len(missing)} measured results are not stored, {count} are (wanted {progress})")
        wrong = [attempt for attempt, pixels in expected.items() if stored[attempt] != pixels]
        if wrong or len(stored) != count:
            raise BrokenError(f"{len(wrong)} results are not what was measured; {count - len(stored)} are double")
        self._check_database()
        return int(count)

    def _check_database(self) -> None:
        with self.database() as db:
            whole = db.execute("PRAGMA integrity_check").fetchone()[0]
            twice = db.execute(
                """SELECT count(*) FROM (SELECT 1 FROM attempt WHERE state = 'leased'
                GROUP BY job_id HAVING count(*) > 1)"""
            ).fetchone()[0]
            adrift = db.execute(
                """SELECT count(*) FROM job WHERE (state = 'leased') !=
                EXISTS (SELECT 1 FROM attempt WHERE attempt.job_id = job.id AND attempt.state = 'leased')"""
            ).fetchone()[0]
            named = [sha256 for (sha256,) in db.execute("SELECT DISTINCT image_sha256 FROM result")]
        if whole != "ok" or twice or adrift:
            raise BrokenError(f"integrity_check: {whole}; {twice} jobs leased twice, {adrift} between two states")
        for sha256 in self.chance.sample(named, min(20, len(named))):
            content = (self.data / "blobs" / sha256[:2] / sha256).read_bytes()
            if hashlib.sha256(content).hexdigest() != sha256:
                raise BrokenError(f"the blob {sha256} is not what its name says")

    # --- the faults: each is done and undone -------------------------------------------------------------------

    def server_killed(self) -> None:
        kill(self.server)
        self.wait()
        self.start_server()

    def agent_killed(self) -> None:
        kill(self.agent)
        self.wait()
        self.start_agent()

    def both_killed(self) -> None:
        kill(self.server)
        kill(self.agent)
        self.start_server()
        self.start_agent()

    def connections_cut(self) -> None:
        self.switched(cut=0.1)

    def requests_doubled_and_reordered(self) -> None:
        self.switched(twice=1.0)

    def blob_corrupted_on_its_way(self) -> None:
        self.switched(flip=0.5)

    def clock_stepped(self) -> None:
        self.switched(clock=self.chance.choice((-86_400, -1, 5, 86_400)))

    def server_disk_full(self) -> None:
        self.switched(full="server")

    def agent_disk_full(self) -> None:
        self.switched(full="agent")

    def database_busy(self) -> None:
        with self.database() as db:
            db.execute("BEGIN IMMEDIATE")
            time.sleep(self.chance.choice((0.1, 0.5, 5.5)))
            db.execute("ROLLBACK")

    def spool_file_truncated(self) -> None:
        self.damage("*.json", lambda content: content[: len(content) // 2])

    def spooled_blob_corrupted(self) -> None:
        self.damage("blobs/*", lambda content: bytes([content[0] ^ 1]) + content[1:])

    def damage(self, pattern: str, how: Any) -> None:
        """With the server away results pile up in the spool; then a file of it is hurt and the agent begins anew."""
        kill(self.server)
        time.sleep(0.1)
        kill(self.agent)
        files = sorted(path for path in self.state.glob(pattern) if path.is_file())
        if files:
            victim = self.chance.choice(files)
            victim.write_bytes(how(victim.read_bytes()))
            entries = [victim] if victim.suffix == ".json" else list(self.state.glob("*.json"))
            self.spoilt |= {path.stem for path in entries if victim.name in (path.name, *path.read_text().split('"'))}
        self.start_server()
        self.start_agent()

    def switched(self, **switches: Any) -> None:
        self.faults.set(**switches)
        time.sleep(0.2)
        self.wait()
        if self.chance.random() < 0.3:  # and on top of it
            self.chance.choice((self.server_killed, self.agent_killed))()
        self.faults.set()

    def wait(self) -> None:
        time.sleep(self.chance.random() * 0.3)


FAULTS = (
    World.server_killed,
    World.agent_killed,
    World.both_killed,
    World.connections_cut,
    World.requests_doubled_and_reordered,
    World.blob_corrupted_on_its_way,
    World.clock_stepped,
    World.server_disk_full,
    World.agent_disk_full,
    World.database_busy,
    World.spool_file_truncated,
    World.spooled_blob_corrupted,
)


def free_ports() -> tuple[int, int]:
    """Two ports of loopback that are free now."""
    with socket.socket() as one, socket.socket() as two:
        one.bind(("127.0.0.1", 0))
        two.bind(("127.0.0.1", 0))
        return one.getsockname()[1], two.getsockname()[1]


def run(rounds: int, seed: int, folder: Path) -> tuple[Counter[str], int, int]:
    """So many rounds; returns how often each fault came, the results stored, and those that the damage cost.

    The kinds come in turn, in an order drawn anew for each turn, so that few rounds meet many of them.
    Raises BrokenError.
    """
    world = World(folder, seed)
    done: Counter[str] = Counter()
    stored = 0
    world.add_work()
    world.start()
    try:
        order: list[Any] = []
        for number in range(rounds):
            order = order or world.chance.sample(FAULTS, len(FAULTS))
            fault = order.pop()
            world.wait()
            fault(world)
            done[fault.__name__.replace("_", " ")] += 1
            try:
                stored = world.check(stored + 1)
            except BrokenError as error:
                raise BrokenError(f"round {number}, {fault.__name__}, seed {seed}: {error}") from None
            world.add_work()
    finally:
        world.stop()
    world._check_database()
    return done, stored, len(world.spoilt)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=20_261_122)
    given = parser.parse_args(arguments)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        try:
            done, stored, spoilt = run(given.rounds, given.seed, Path(folder))
        except BrokenError as error:
            print(f"BROKEN: {error}")
            return 1
    for name, count in done.most_common():
        print(f"{count:4d} x {name}")
    print(
        f"{sum(done.values())} rounds in {time.monotonic() - began_s:.0f} s: {stored} results stored, every one that "
        f"was safe in a spool exactly once ({spoilt} spooled files were damaged); integrity_check ok after each"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
