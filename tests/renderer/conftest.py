"""What the renderer's tests share: scenes from a few lines of XML, renderings, its command, and z-scores."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render import cli
from joulebox_render.session import Image, Session
from joulebox_render.settings import make_settings
from plain_settings import PLAIN

# A camera at the origin that looks along -z, so that film x runs along +x and film y along -y.
CAMERA = '<transform name="to_world"><lookat origin="0,0,0" target="0,0,-1" up="0,1,0"/></transform>'


def scene_text(body: str, camera: str = CAMERA, fov_deg: float = 60.0) -> str:
    """A scene file around `body`: a camera with a square film of 16 x 16 pixels."""
    return (
        f'<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="{fov_deg}"/>'
        f'<float name="near_clip" value="1e-4"/>{camera}<film type="hdrfilm"><integer name="width" value="16"/>'
        f'<integer name="height" value="16"/></film></sensor>{body}</scene>'
    )


@pytest.fixture
def make_scene(tmp_path: Path) -> Callable[..., Path]:
    """make_scene(body, camera=..., fov_deg=...) writes a scene and returns its file."""
    written = iter(range(1000))

    def make(body: str, **parts: Any) -> Path:
        file = tmp_path / f"scene{next(written)}.xml"
        file.write_text(scene_text(body, **parts), encoding="utf-8")
        return file

    return make


@pytest.fixture
def open_session() -> Iterator[Callable[..., Session]]:
    """open_session(scene, defines, force_all, chunk_rays, **settings); closed when the test ends."""
    opened: list[Session] = []

    def open_(
        scene: str | Path,
        defines: dict[str, str] | None = None,
        force_all: bool = False,
        chunk_rays: int = 16_384,
        **settings: Any,
    ) -> Session:
        session = Session(scene, make_settings({**PLAIN, **settings}), defines, force_all, chunk_rays)
        opened.append(session)
        return session

    yield open_
    for session in opened:
        session.__exit__(None, None, None)


@pytest.fixture
def render(open_session: Callable[..., Session]) -> Callable[..., Image]:
    """render(scene, ...) as open_session, and one image of it."""
    return lambda scene, **how: open_session(scene, **how).render()


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """call(*arguments) -> (exit code, stdout, stderr), in this process: no second start of Python."""

    def call_(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["joulebox-render", *map(str, arguments)])
        capfd.readouterr()
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capfd.readouterr()
        return code, out, err

    return call_


@pytest.fixture
def z_score() -> Callable[[Any, float], float]:
    """z_score(samples, expected): distance of the mean from what is expected, in its standard errors."""

    def score(samples: Any, expected: float) -> float:
        values = np.asarray(samples, dtype=np.float64).ravel()
        return float((values.mean() - expected) / (values.std(ddof=1) / np.sqrt(len(values))))

    return score
