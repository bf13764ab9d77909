"""`joulebox report`: a page of its own over a stored sweep, with figures and tables beside it."""

import csv
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from fake_device import measure_document
from joulebox_server.reports.document import Chart
from joulebox_server.reports.page import PAGE, DrawnChart
from server_testing import Run, Server, failed

LOCAL = re.compile(r"#[\w-]+|data:image/(png|svg\+xml);base64,[A-Za-z0-9+/=]+")


class Page(HTMLParser):
    """What a page shows and what it points to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.elements: list[str] = []
        self.policy = ""
        self.ids: list[str] = []
        self._hidden = False
        self._words: list[str] = []
        self.feed(text)
        self.words = " ".join(" ".join(self._words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.elements.append(tag)
        self._hidden = tag in ("script", "style")
        self.addresses += [given[name] or "" for name in ("src", "href", "srcset", "action", "data") if name in given]
        self.ids += [given["id"] or ""] if "id" in given else []
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"] or ""

    def handle_endtag(self, tag: str) -> None:
        self._hidden = False

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self._words.append(data)


def page_of(folder: Path) -> Page:
    """The page of a report, seen to point to nothing outside its folder."""
    found = Page((folder / PAGE).read_text(encoding="utf-8"))
    for address in found.addresses:
        assert LOCAL.fullmatch(address) or (folder / address).is_file(), f"points to {address[:100]}"
    assert found.policy.startswith("default-src 'none'; script-src 'sha256-") or "script" not in found.elements
    assert len(set(found.ids)) == len(found.ids)
    return found


def points_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "tables" / "points.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_sweep(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    sweep = live.add_sweep(axes={"global_photons": [10_000, 50_000, 100_000]}, limit=1e6)
    live.device().work()
    live.wait(sweep["id"], "done")
    out = tmp_path / "out"
    code, told, _ = run("report", "small", "-o", str(out), "--json", *there)
    assert code == 0
    files = [Path(name) for name in json.loads(told)["files"]]
    assert sorted(files) == sorted(path for path in out.rglob("*") if path.is_file())
    page = page_of(out)
    for words in (
        "Sweep small",
        "measured joules",
        "battery_gauge (measured)",
        "global_photons 10,000, 50,000, 100,000",
    ):
        assert words in page.words

    tradeoff = live.get(f"/sweeps/{sweep['id']}/tradeoff")
    answer = live.get(f"/sweeps/{sweep['id']}/recommendation")
    assert f"box on laptop: with {answer['label']} an image costs" in page.words
    assert json.loads((out / "settings" / "box-laptop.json").read_text()) == answer["settings"]
    rows = points_of(out)
    assert [row["label"] for row in rows] == [*(point["label"] for point in tradeoff["points"]), "reference"]
    for row, point in zip(rows, tradeoff["points"], strict=False):
        assert float(row["energy_j"]) == point["energy_j"]["value"]
        assert float(row["difference_high"]) == point["difference"]["high"]
        assert int(row["set.global_photons"]) == point["settings"]["global_photons"]
        assert float(row["stage.direct_j"]) == point["stages"]["direct"]["energy_j"]
    assert len((out / "tables" / "results.csv").read_text().splitlines()) == 1 + 8
    for name in ("tradeoff", "stages"):
        assert (out / "figures" / f"box-laptop-{name}.svg").read_text().startswith("<svg")
        assert (out / "figures" / f"box-laptop-{name}.png").read_bytes().startswith(b"\x89PNG")
    pictures = {path.stem for path in (out / "figures").glob("*.png")} - {"box-laptop-tradeoff", "box-laptop-stages"}
    roles = ("reference", "recommended", "recommended-delta", "best", "best-delta")
    assert pictures == {f"box-laptop-{role}" for role in roles}  # the recommended one differs most


def test_what_the_page_shows_is_escaped(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    """A reason comes from a device, and may hold anything."""
    reason = '<img src="http://elsewhere.example/x.png"></script><script>alert(1)</script>'
    sweep = live.add_sweep(repeats=1)
    device = live.device()
    while leases := device.lease():
        if leases[0]["settings"].get("global_photons") == 10_000:
            path = f"/v1/attempts/{leases[0]['attempt_id']}/release"
            answer = live.client.post(path, headers=device.headers, json={"reason": reason, "failed": True})
            assert answer.is_success, answer.text
        else:
            device.finish(leases[0])
    live.wait(sweep["id"], "failed")
    assert run("report", sweep["id"], "-o", str(tmp_path / "out"), *there)[0] == 0
    page = page_of(tmp_path / "out")
    assert reason in page.words
    assert "1 job of small failed; what they would have shown is missing" in page.words


def test_no_finished_job(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    sweep = live.add_sweep()
    assert run("report", sweep["id"], "-o", str(tmp_path / "out"), *there)[0] == 0
    page = page_of(tmp_path / "out")
    assert "small is running: 0 of 6 jobs are done" in page.words
    assert "Nothing has been measured here yet" in page.words
    assert "script" not in page.elements
    assert points_of(tmp_path / "out") == []


def test_time_only(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    """Where no joules are known none are shown."""
    sweep = live.add_sweep(repeats=1)
    device = live.device()
    nothing = {"gross": None, "net": None, "counter": None}
    for _ in range(4):
        (lease,) = device.lease()
        lease["measure"]["meter"] = False
        assert device.finish(lease, quality="none", energy_j_per_image=nothing, stages={}).status_code == 201
    live.wait(sweep["id"], "done")
    assert run("report", sweep["id"], "-o", str(tmp_path / "out"), "--difference-limit", "1e6", *there)[0] == 0
    words = page_of(tmp_path / "out").words
    assert "time only" in words
    assert not re.search(r"\d J\b", words)
    assert "time per image [s]" in (tmp_path / "out" / "figures" / "box-laptop-tradeoff.svg").read_text()
    assert {row["energy_j"] for row in points_of(tmp_path / "out")} == {""}
    # joules are asked for where there are none: said in the place of the answer, and the rest is told
    assert run("report", sweep["id"], "-o", str(tmp_path / "joules"), "--budget-j", "5", *there)[0] == 0
    assert "no energy is known" in page_of(tmp_path / "joules").words


def test_one_point_over_an_earlier_report(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    """The page, figures and tables of the earlier report are gone; nothing else is."""
    several, one = live.add_sweep(repeats=1), live.add_sweep(name="one", axes={}, repeats=1, scenes=["box"])
    live.device().work()
    live.wait(several["id"], "done")
    live.wait(one["id"], "done")
    out = str(tmp_path / "out")
    assert run("report", "small", "one", "-o", out, *there)[0] == 0
    assert len(points_of(tmp_path / "out")) == 3 + 2
    page_of(tmp_path / "out")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert run("report", "one", "-o", out, *there)[0] == 0
    page = page_of(tmp_path / "out")
    assert "nothing: one configuration" in page.words
    assert "No setting was varied alone" in page.words
    assert len(points_of(tmp_path / "out")) == 2
    assert not list((tmp_path / "out" / "figures").glob("small-*"))
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


def test_devices_side_by_side(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    fast, slow = live.device("fast"), live.device("slow")
    sweep = live.add_sweep(devices=["fast", "slow"], repeats=1)
    fast.work()

    while leases := slow.lease():
        gross = measure_document(leases[0])["energy_j_per_image"]["gross"]
        changes = {"energy_j_per_image": {"gross": gross and {name: 2 * value for name, value in gross.items()}}}
        assert slow.finish(leases[0], **changes, **({"quality": "replayed"} if gross else {})).status_code == 201
    live.wait(sweep["id"], "done")
    assert run("report", "small", "--device", "slow", "--device", "fast", "-o", str(tmp_path / "out"), *there)[0] == 0
    words = page_of(tmp_path / "out").words
    assert "box: devices side by side" in words
    assert "These are measured joules and replayed joules" in words
    assert "fast measured joules 26 J (25.5 to 26.5)" in words  # the reference: 10 W x 2.6 s, 2 % off at most
    assert "0.5 (0.5 to 0.5) 2 of 2 configurations" in words
    svg = (tmp_path / "out" / "figures" / "devices-1.svg").read_text()
    assert "slow, replayed" in svg
    assert run("report", "small", "--device", "slow", "-o", str(tmp_path / "slow"), *there)[0] == 0
    assert "side by side" not in page_of(tmp_path / "slow").words


def test_wrong_use(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    sweep = live.add_sweep()
    failed(run("report", "small", "-o", str(tmp_path / "a"), "--scene", "hall", *there), 1, "no scene 'hall'")
    failed(run("report", "small", "-o", str(tmp_path / "a"), "--device", "hall", *there), 1, "no device 'hall'")
    failed(run("report", "nosuch", "-o", str(tmp_path / "a"), *there), 1, "nosuch")
    assert not (tmp_path / "a" / PAGE).exists()
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / PAGE).write_text("<html>somebody's own</html>")
    failed(run("report", sweep["id"], "-o", str(taken), *there), 2, "holds other files")
    failed(run("report", sweep["id"], "-o", str(taken / PAGE), *there), 2, "is a file")
    failed(run("report", sweep["id"], "-o", str(taken / PAGE / "below"), *there), 1, "cannot be written", "directory")
    assert (taken / PAGE).read_text() == "<html>somebody's own</html>"
    failed(run("report", sweep["id"], "-o", str(tmp_path / "b"), "--server", "http://127.0.0.1:9"), 1, "no server")


@pytest.mark.parametrize("name", ["figures", "tables"])
def test_what_stands_in_the_way(run: Run, live: Server, there: list[str], tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    sweep = live.add_sweep(repeats=1)
    live.device().work()
    live.wait(sweep["id"], "done")
    assert run("report", sweep["id"], "-o", str(out), *there)[0] == 0
    for path in (out / name).iterdir():
        path.unlink()
    (out / name).rmdir()
    (out / name).write_text("a file")
    failed(run("report", sweep["id"], "-o", str(out), *there), 1, "cannot be written")


def test_the_smaller_picture_of_a_chart_stands_in() -> None:
    chart = Chart("points", {}, "", "")
    assert DrawnChart(chart, b"<svg" + 100 * b" ", b"PNG").stand_in == "data:image/png;base64,UE5H"
    assert DrawnChart(chart, b"<svg", 100 * b"P").stand_in == "data:image/svg+xml;base64,PHN2Zw=="
