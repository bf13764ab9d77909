"""Scene bundles from the server: unpacked once, and never outside of their folder."""

import io
import stat
import zipfile
from pathlib import Path

import joulebox_agent.fleet.bundle as bundle
import pytest
from fake_fleet import TOKEN, FakeFleet, scene_zip
from joulebox_agent.errors import BundleError, ServerRefusedError
from joulebox_agent.fleet.server import Server


@pytest.fixture
def fleet() -> FakeFleet:
    return FakeFleet()


@pytest.fixture
def cache(tmp_path: Path, fleet: FakeFleet) -> bundle.SceneCache:
    server = Server("http://fleet", TOKEN, transport=fleet.transport, quick_wait_s=0.001)
    return bundle.SceneCache(tmp_path / "scenes", server)


def test_a_bundle_is_fetched_once_into_a_folder_of_the_scenes_name(cache: bundle.SceneCache, fleet: FakeFleet) -> None:
    digest = fleet.add_scene()
    folder = cache.fetch("cornell", digest)
    assert folder.name == "cornell"
    assert (folder / "scene.xml").read_bytes() == b"<scene/>"
    assert (folder / "meshes/a.obj").exists()
    assert cache.fetch("cornell", digest) == folder
    assert fleet.calls.count(f"GET /blobs/{digest}") == 1


@pytest.mark.parametrize("name", ["../evil.txt", "/evil.txt", "meshes/../../evil.txt", "..\\evil.txt", "C:evil.txt"])
def test_a_path_that_leaves_the_folder_is_refused(
    cache: bundle.SceneCache, fleet: FakeFleet, tmp_path: Path, name: str
) -> None:
    digest = fleet.add_scene(scene_zip({"scene.xml": b"", name: b"evil"}))
    with pytest.raises(BundleError, match="outside"):
        cache.fetch("cornell", digest)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_link_is_refused(cache: bundle.SceneCache, fleet: FakeFleet) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("scene.xml", "")
        link = zipfile.ZipInfo("link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(BundleError, match="link"):
        cache.fetch("cornell", fleet.add_scene(buffer.getvalue()))


def test_too_much_is_refused(cache: bundle.SceneCache, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle, "LARGEST_SCENE_BYTES", 1000)
    with pytest.raises(BundleError, match="more than 2 GiB"):
        cache.fetch("cornell", fleet.add_scene(scene_zip({"scene.xml": b"x" * 1001})))
    monkeypatch.setattr(bundle, "MOST_FILES", 2)
    many = {"scene.xml": b"", "a": b"", "b": b""}
    with pytest.raises(BundleError, match="3 files"):
        cache.fetch("cornell", fleet.add_scene(scene_zip(many)))


def test_a_zip_that_lies_about_its_sizes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle, "LARGEST_SCENE_BYTES", 1000)
    monkeypatch.setattr(bundle, "_check_members", lambda members: None)  # as if the headers were believed
    archive = tmp_path / "b.zip"
    archive.write_bytes(scene_zip({"scene.xml": b"x" * 5000}))
    with pytest.raises(BundleError, match="more than 2 GiB"):
        bundle.unpack(archive, tmp_path / "out")


def damaged_zip() -> bytes:
    """Whose deflated bytes mean nothing."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scene.xml", bytes(range(256)))
    return out.getvalue()[:39] + b"\xff" * 9 + out.getvalue()[48:]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"not a zip", "not a readable zip"),
        (scene_zip()[:-30], "not a readable zip"),
        (damaged_zip(), "not a readable zip"),
        (scene_zip({"readme": b""}), "no scene.xml"),
    ],
)
def test_what_is_no_scene_is_refused(
    cache: bundle.SceneCache, fleet: FakeFleet, content: bytes, words: str, tmp_path: Path
) -> None:
    with pytest.raises(BundleError, match=words):
        cache.fetch("cornell", fleet.add_scene(content))
    assert list((tmp_path / "scenes").iterdir()) == []


@pytest.mark.parametrize("name", ["../cornell", "Meine K\u00fcche", "C:", ".", "x" * 101])
def test_a_name_that_is_none_for_a_folder_becomes_none(
    cache: bundle.SceneCache, fleet: FakeFleet, tmp_path: Path, name: str
) -> None:
    """Whatever people call a scene, it is measured, and in its own place."""
    digest = fleet.add_scene()
    assert cache.fetch(name, digest) == tmp_path / "scenes" / digest / "scene"
    assert cache.fetch(name, digest).joinpath("scene.xml").is_file()


def test_a_bundle_must_have_its_hash(cache: bundle.SceneCache, fleet: FakeFleet) -> None:
    fleet.blobs["0" * 64] = scene_zip()
    with pytest.raises(BundleError, match="does not have its hash"):
        cache.fetch("cornell", "0" * 64)
    with pytest.raises(ServerRefusedError, match="no such blob"):
        cache.fetch("cornell", "1" * 64)
