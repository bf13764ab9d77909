"""How the dashboard's files are served: headers, caching, and the chart library made offline."""

import gzip
import re
from pathlib import Path

import pytest
from fastapi import FastAPI
from joulebox_server import pages
from starlette.testclient import TestClient

LINES_AT_MOST = 2000


@pytest.fixture(scope="module")
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def client(cache_folder: Path) -> TestClient:
    app = FastAPI()
    pages.mount_pages(app, cache_folder=cache_folder)
    return TestClient(app)


@pytest.mark.parametrize("path", ["/", "/assets/app.js", "/assets/style.css", "/assets/icon.svg", "/assets/vega.js"])
def test_every_file_has_the_page_headers(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 200
    for name, value in pages.PAGE_HEADERS.items():
        assert answer.headers[name] == value
    policy = answer.headers["Content-Security-Policy"]
    assert "unsafe" not in policy
    assert "http" not in policy  # no other host
    assert answer.headers["Cache-Control"] == "no-cache"


def test_unchanged_files_are_not_sent_again(client: TestClient) -> None:
    first = client.get("/assets/app.js")
    again = client.get("/assets/app.js", headers={"If-None-Match": first.headers["ETag"]})
    assert again.status_code == 304
    assert again.content == b""


def test_nothing_outside_the_folder_is_served(client: TestClient) -> None:
    for path in ("/assets/../server/pyproject.toml", "/assets/%2e%2e/server/pyproject.toml", "/assets/nothing.js"):
        assert client.get(path).status_code == 404


def test_chart_library_is_made_once_and_kept_forever(client: TestClient, cache_folder: Path) -> None:
    entry = client.get("/assets/vega.js").text
    found = re.fullmatch(r'export \* from "(/assets/vega-[0-9a-f]{16}\.js)";\n', entry)
    assert found is not None
    plain = client.get(found[1], headers={"Accept-Encoding": "identity"})
    assert plain.headers["Cache-Control"] == pages.FOREVER
    assert plain.headers["Content-Type"].startswith("text/javascript")
    assert re.search(r"export\{.* as vegaEmbed,.* as vega\};?\s*$", plain.text)
    assert "import(" not in plain.text  # the bundle is whole: it loads nothing more
    stamps = {path: path.stat().st_mtime_ns for path in cache_folder.iterdir()}
    assert len(stamps) == 2
    packed = client.get(found[1], headers={"Accept-Encoding": "gzip"})
    assert packed.headers["Content-Encoding"] == "gzip"
    assert packed.text == plain.text
    assert {path: path.stat().st_mtime_ns for path in cache_folder.iterdir()} == stamps


def test_chart_library_of_another_version_is_not_there(client: TestClient) -> None:
    assert client.get("/assets/vega-0123456789abcdef.js").status_code == 404


def test_chart_library_without_a_writable_cache(tmp_path: Path) -> None:
    """A file stands where the folder should be: the library is made elsewhere, once."""
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    path = pages.chart_library(blocked)
    assert blocked not in path.parents
    assert gzip.decompress(path.with_name(path.name + ".gz").read_bytes()) == path.read_bytes()
    assert pages.chart_library(blocked) == path


def test_chart_library_returns_after_the_cache_was_emptied(tmp_path: Path) -> None:
    path = pages.chart_library(tmp_path)
    path.unlink()
    assert pages.chart_library(tmp_path) == path
    assert path.is_file()


def test_missing_pages_are_a_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(pages, "__file__", str(tmp_path / "a" / "b" / "pages.py"))
    with pytest.raises(pages.PagesError, match="reinstall joulebox-server"):
        pages.web_folder()


def test_the_pages_stay_small_and_load_nothing_from_elsewhere() -> None:
    folder = pages.web_folder()
    scripts = sorted(folder.glob("*.js"))
    assert sum(len(path.read_text().splitlines()) for path in scripts) < LINES_AT_MOST
    for path in [*scripts, *folder.glob("*.html"), *folder.glob("*.css")]:
        assert re.findall(r"""(?:src|href|from|import|url)\s*[=(]?\s*["'(]https?:""", path.read_text()) == []
    page = (folder / "index.html").read_text()
    assert not re.search(r"\son\w+=|<style|\sstyle=|<script>", page)  # the policy would refuse them
