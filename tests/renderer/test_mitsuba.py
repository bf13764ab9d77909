"""Our reading of scenes against Mitsuba 3's: the same rays hit the same places with the same normals.

Distances agree to 1e-4 relative and normals to 1e-3: single precision on both sides, with room for meshes,
which Mitsuba transforms in single precision.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from joulebox_render.records import GLASS, SPHERE, Scene
from joulebox_render.scene import list_scenes, load_scene

mi: Any = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed; pip install mitsuba to compare with it")
mi.set_variant("scalar_rgb")

F8 = npt.NDArray[np.float64]
HERE = Path(__file__).parent
GRID = 12
SENSOR = (
    '<sensor type="perspective"><float name="fov" value="50"/><transform name="to_world">'
    '<lookat origin="1.3,1.7,3.1" target="0.1,0.05,0" up="0,1,0"/></transform><film type="hdrfilm">'
    f'<integer name="width" value="{GRID}"/><integer name="height" value="{GRID}"/></film></sensor>'
)
LAMP = '<emitter type="point"><point name="position" value="0,3,0"/></emitter>'
STEPS = '<scale value="0.9"/><rotate x="0.8" y="0.6" angle="25"/><translate value="0.1, -0.2, 0.1"/>'

FOLD_OBJ = "v -1 -1 0\nv 1 -1 0\nv 1 1 0.3\nv -1 1 0.8\nvt 0 0\nvt 1 1\n"
NORMALS_OBJ = "vn 0 0 1\nvn 0 0.6 0.8\nvn 0.6 0 0.8\n"
MESHES = {
    "fold.obj": FOLD_OBJ + "f 1 2 3 4\n",
    "smooth.obj": FOLD_OBJ + NORMALS_OBJ + "f 1/1/1 2/2/2 3/1/3\nf 1/1/2 3/2/2 4/2/1\n",
    "inward.obj": FOLD_OBJ + NORMALS_OBJ + "f 3//3 2//2 1//1\nf 4//1 3//2 1//2\n",
    "fold.ply": (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "-1 -1 0\n1 -1 0\n1 1 0.3\n-1 1 0.8\n3 0 1 2\n3 0 2 3\n"
    ),
    "smooth.ply": (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "property float nx\nproperty float ny\nproperty float nz\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "-1 -1 0 0 0 1\n1 -1 0 0 0.6 0.8\n1 1 0.3 0.6 0 0.8\n-1 1 0.8 0 0 1\n3 0 1 2\n3 0 2 3\n"
    ),
}


def write_scene(folder: Path, body: str, sensor: str = SENSOR, lamp: str = LAMP) -> Path:
    """A folder with a scene and the meshes above."""
    for name, text in MESHES.items():
        (folder / name).write_text(text)
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{sensor}{lamp}{body}</scene>')
    return folder / "scene.xml"


def triangle_hits(scene: Scene, origin: F8, direction: F8) -> tuple[F8, F8]:
    """(T,) distances, inf for a miss, and (T, 3) interpolated normals (Moeller and Trumbore 1997)."""
    a, b, c = (scene.vertices[scene.triangles[:, i]].astype(np.float64) for i in range(3))
    p = np.cross(direction, c - a)
    determinant = np.einsum("tx,tx->t", b - a, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("tx,tx->t", origin - a, p) / determinant
        q = np.cross(origin - a, b - a)
        v = q @ direction / determinant
        t = np.einsum("tx,tx->t", c - a, q) / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    weights = np.stack([1 - u - v, u, v], axis=1)
    normals = np.einsum("tc,tcx->tx", weights, scene.corner_normals)
    return np.where(inside, t, np.inf), normals


def analytic_hits(scene: Scene, origin: F8, direction: F8) -> tuple[F8, F8]:
    """(A,) distances and (A, 3) normals of spheres and disks."""
    distances, normals = [], []
    for i, kind in enumerate(scene.analytic_kind):
        center = scene.analytic_center[i].astype(np.float64)
        axis, radius = scene.analytic_normal[i].astype(np.float64), float(scene.analytic_radius[i])
        if kind == SPHERE:
            b = float(direction @ (center - origin))
            root = b * b - float((center - origin) @ (center - origin)) + radius**2
            roots = [s for s in (b - math.sqrt(max(root, 0)), b + math.sqrt(max(root, 0))) if s > 0]
            t = roots[0] if root >= 0 and roots else math.inf
            normals.append((origin + t * direction - center) / radius * axis[0] if t < math.inf else axis)
        else:
            t = float((center - origin) @ axis) / float(direction @ axis)
            away = np.linalg.norm(origin + t * direction - center)
            t = t if t > 0 and away <= radius else math.inf
            normals.append(axis)
        distances.append(t)
    return np.array(distances), np.array(normals).reshape(-1, 3)


def nearest(scene: Scene, origin: F8, direction: F8) -> tuple[float, F8, int]:
    """Distance, unit shading normal and primitive of the nearest hit; infinite distance for none."""
    found = [triangle_hits(scene, origin, direction), analytic_hits(scene, origin, direction)]
    distances = np.concatenate([part[0] for part in found])
    normals = np.concatenate([part[1] for part in found])
    row = int(np.argmin(distances))
    return float(distances[row]), normals[row] / np.linalg.norm(normals[row]), row


def assert_same_hits(file: Path) -> int:
    """Compare all rays of a GRID x GRID camera; returns how many hit something."""
    ours, theirs = load_scene(file), mi.load_file(str(file))
    sensor = theirs.sensors()[0]
    # Mitsuba takes the front from the shading normal; we wind triangles so that both normals agree.
    assert (np.einsum("tcx,tx->tc", ours.corner_normals, ours.face_normals) > 0.0).all()
    hits = 0
    for row in range(GRID):
        for column in range(GRID):
            # Off the middle of pixels: shapes centred in the view have edges and diagonals there.
            film = ((column + 0.37) / GRID, (row + 0.61) / GRID)
            ray, _ = sensor.sample_ray(0.0, 0.5, film, (0.5, 0.5))
            origin, direction = np.array(ray.o, np.float64), np.array(ray.d, np.float64)
            expected = theirs.ray_intersect(ray)
            distance, normal, primitive = nearest(ours, origin, direction)
            where = f"film position {film}"
            assert (distance < math.inf) == expected.is_valid(), where
            if not expected.is_valid():
                continue
            hits += 1
            assert distance == pytest.approx(expected.t, rel=1e-4), where
            np.testing.assert_allclose(normal, np.array(expected.sh_frame.n), atol=1e-3, err_msg=where)
            emitted = np.array(expected.emitter(theirs).eval(expected)) if expected.emitter(theirs) else np.zeros(3)
            light = ours.light[primitive]
            facing = light >= 0 and normal @ direction < 0
            np.testing.assert_allclose(
                ours.lights.radiance[light] if facing else np.zeros(3), emitted, rtol=1e-4, err_msg=where
            )
    return hits


@pytest.mark.parametrize("name", sorted({entry.name for entry in list_scenes()} - {"phong-spheres"}))
def test_shipped_scene(name: str) -> None:
    """Every shipped scene loads unchanged in Mitsuba, which has no phong, and is the same scene there."""
    entry = next(entry for entry in list_scenes() if entry.name == name)
    assert assert_same_hits(entry.path / "scene.xml") > GRID * GRID // 2


TRANSFORMS = {
    "plain": "",
    "mirrored": '<scale x="-1"/>',
    "turned": '<scale z="-1"/>',
    "flat": '<scale z="0.4"/>',
}
SHAPES = ("rectangle", "cube", "disk", "sphere", *MESHES)


@pytest.mark.parametrize("flip", ["false", "true"])
@pytest.mark.parametrize(
    ("kind", "transform"),
    [(k, t) for k in SHAPES for t in TRANSFORMS if (k, t) != ("sphere", "flat")],  # ellipsoids are refused
)
def test_shape(tmp_path: Path, kind: str, transform: str, flip: str) -> None:
    """Position and shading normal of each shape, mirrored, stretched and flipped, with a light on it."""
    filename = f'<string name="filename" value="{kind}"/>' if "." in kind else ""
    body = (
        f'<shape type="{kind.split(".")[-1]}">{filename}<boolean name="flip_normals" value="{flip}"/>'
        f'<transform name="to_world">{TRANSFORMS[transform]}{STEPS}</transform>'
        '<emitter type="area"><rgb name="radiance" value="1 2 3"/></emitter></shape>'
    )
    assert assert_same_hits(write_scene(tmp_path, body)) > GRID


@pytest.mark.parametrize("name", MESHES)
def test_flat_meshes(tmp_path: Path, name: str) -> None:
    body = (
        f'<shape type="{name[-3:]}"><string name="filename" value="{name}"/>'
        f'<boolean name="face_normals" value="true"/><transform name="to_world">{STEPS}</transform></shape>'
    )
    assert assert_same_hits(write_scene(tmp_path, body)) > GRID


def test_sphere_center_and_radius(tmp_path: Path) -> None:
    """center and radius act before to_world."""
    body = (
        '<shape type="sphere"><point name="center" x="0.2" y="0.1" z="0"/><float name="radius" value="0.7"/>'
        f'<transform name="to_world">{STEPS}</transform></shape>'
    )
    assert assert_same_hits(write_scene(tmp_path, body)) > GRID


@pytest.mark.parametrize(
    "step",
    [
        '<matrix value="0.8 0.1 0 0.1 0 0.9 0.2 -0.2 -0.1 0 1 0.05 0 0 0 1"/>',
        '<matrix value="0.8 0.1 0 0 0.9 0.2 -0.1 0 1"/>',
        '<rotate value="0.36, 0.48, 0.8" angle="40"/>',
        '<rotate y="-1" angle="400"/><scale x="1.5" y="0.5"/>',
        '<lookat origin="0.1, 0.2, 0.3" target="1, 2, 3" up="0, 1, 0.2"/>',
        '<translate y="0.3"/><rotate z="1" angle="-30"/><translate value="0.1"/>',
    ],
)
def test_transform_step(tmp_path: Path, step: str) -> None:
    body = f'<shape type="cube"><transform name="to_world"><scale value="0.6"/>{step}</transform></shape>'
    assert assert_same_hits(write_scene(tmp_path, body)) > GRID


@pytest.mark.parametrize("size", [(40, 20), (20, 40)])
@pytest.mark.parametrize("axis", ["x", "y", "smaller", "larger", "diagonal", "focal length"])
def test_field_of_view(tmp_path: Path, axis: str, size: tuple[int, int]) -> None:
    """The horizontal angle that follows from fov and fov_axis is Mitsuba's."""
    fov = f'<float name="fov" value="50"/><string name="fov_axis" value="{axis}"/>'
    if axis == "focal length":
        fov = '<string name="focal_length" value="28mm"/>'
    film = f'<integer name="width" value="{size[0]}"/><integer name="height" value="{size[1]}"/>'
    sensor = f'<sensor type="perspective">{fov}<film type="hdrfilm">{film}</film></sensor>'
    file = write_scene(tmp_path, '<shape type="cube"/>', sensor)
    camera = load_scene(file).camera
    width, height = size
    length = {
        "x": width,
        "y": height,
        "smaller": min(size),
        "larger": max(size),
        "diagonal": math.hypot(width, height),
    }[camera.fov_axis]
    x_fov = 2 * math.degrees(math.atan(math.tan(math.radians(camera.fov_deg) / 2) * width / length))
    assert x_fov == pytest.approx(mi.traverse(mi.load_file(str(file)).sensors()[0])["x_fov"], rel=1e-5)


@pytest.mark.parametrize("inside", ["bk7", "air", "water", "diamond", "vacuum", "pet", "silicone oil", "amber"])
def test_index_of_refraction(tmp_path: Path, inside: str) -> None:
    body = (
        f'<shape type="cube"><bsdf type="dielectric"><string name="int_ior" value="{inside}"/>'
        '<string name="ext_ior" value="pyrex"/></bsdf></shape>'
    )
    file = write_scene(tmp_path, body)
    ours, theirs = load_scene(file), mi.load_file(str(file))
    assert ours.materials.kind[ours.material[0]] == GLASS
    expected = mi.traverse(theirs.shapes()[0].bsdf())["eta"]
    assert ours.materials.ior[ours.material[0]] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    "lamp",
    [
        '<emitter type="point"><point name="position" x="0.5" y="2" z="0"/>'
        '<rgb name="intensity" value="1 2 3"/></emitter>',
        '<emitter type="point"><transform name="to_world"><scale value="3"/><translate y="2"/></transform></emitter>',
        '<emitter type="point"><spectrum name="intensity" value="2"/></emitter>',
        '<emitter type="spot"><rgb name="intensity" value="3 2 1"/></emitter>',
        '<emitter type="spot"><float name="cutoff_angle" value="70"/><float name="beam_width" value="10"/>'
        '<transform name="to_world"><lookat origin="0,2,0" target="1,0,0" up="0,0,1"/></transform></emitter>',
    ],
)
def test_point_and_spot_lights(tmp_path: Path, lamp: str) -> None:
    """Irradiance that reaches points all around the light; spots fall off linearly in the angle."""
    file = write_scene(tmp_path, '<shape type="cube"/>', lamp=lamp)
    lights, emitter = load_scene(file).lights, mi.load_file(str(file)).emitters()[0]
    beam, cutoff = np.arccos(lights.cone_cos[0].astype(np.float64))
    points = np.random.default_rng(3).uniform(-4, 4, (200, 3))
    lit = 0
    for point in points:
        interaction = mi.SurfaceInteraction3f()
        interaction.p = point
        _, arriving = emitter.sample_direction(interaction, (0.5, 0.5))
        away = point - lights.position[0]
        distance = float(np.linalg.norm(away))
        falloff = 1.0
        if cutoff < math.pi / 2 - 1e-6:
            angle = math.acos(float(np.clip(away @ lights.normal[0] / distance, -1, 1)))
            falloff = float(np.clip((cutoff - angle) / (cutoff - beam), 0, 1))
        lit += falloff > 0
        np.testing.assert_allclose(
            lights.radiance[0] * falloff / distance**2,
            np.array(arriving),
            rtol=2e-3,
            atol=1e-5,
            err_msg=str(point),
        )
    assert lit >= 3


def test_default_materials(tmp_path: Path) -> None:
    """Shapes without bsdf, with and without a light, reflect what they reflect in Mitsuba."""
    body = '<shape type="cube"/><shape type="disk"><emitter type="area"/></shape>'
    file = write_scene(tmp_path, body)
    ours = load_scene(file)
    theirs = mi.load_file(str(file))
    for shape in theirs.shapes():
        row = ours.material[-1] if shape.is_emitter() else ours.material[0]
        expected = mi.traverse(shape.bsdf())["reflectance.value"]
        np.testing.assert_allclose(ours.materials.albedo[row], expected)
