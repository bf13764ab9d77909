"""Every bad scene is refused with one sentence that names the file, the line, and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest
from scene_files import FIRST_LINE, LAMP, SENSOR, SHAPE, bsdf, message, moved, refused, shape


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (shape("", "rectangel"), ['"rectangel"', "did you mean rectangle?", "sphere"]),
        (shape("", "cylinder"), ['"cylinder"', "known: cube, disk, obj, ply, rectangle, sphere"]),
        ("<shape/>", ["<shape> has no type"]),
        (bsdf("", "phnog"), ['unknown bsdf "phnog"', "did you mean phong?", "diffuse"]),
        (bsdf("", "roughdielectric"), ["did you mean dielectric?"]),
        ('<bsdf type="plastic"/>', ['unknown bsdf "plastic"']),
        ('<emitter type="envmap"/>', ['unknown emitter "envmap"', "constant", "point", "spot"]),
        ('<emitter type="area"/>', ["inside a <shape>"]),
        (shape('<emitter type="point"/>'), ['"area"']),
        (shape('<emitter type="area"/><emitter type="area"/>'), ["one emitter"]),
        (shape('<bsdf type="diffuse"/><bsdf type="diffuse"/>'), ["2 bsdfs", "one"]),
        ("<shpae/>", ["<shpae>", "did you mean shape?"]),
        ('<film type="hdrfilm"/>', ["<film>", "directly in <scene>"]),
        ('<float name="x" value="1"/>', ["<float>", "directly in <scene>"]),
        ('<include filename="other.xml"/>', ["<include>", "one file"]),
        ('<path value="/etc"/>', ["<path>"]),
        ('<alias id="a" as="b"/>', ["alias"]),
        (bsdf('<texture type="bitmap" name="reflectance"/>'), ["textures are not supported", "<rgb>"]),
        ("words", ['"words"', "value="]),
        (shape('<float name="radus" value="1"/>', "sphere"), ['"radus"', "did you mean radius?", "center"]),
        (shape('<float value="1"/>', "sphere"), ["no name"]),
        (shape('<float name="radius"/>', "sphere"), ["no value"]),
        (shape('<float name="radius" value="1"/>' * 2, "sphere"), ["given twice", "line 5"]),
        (shape('<string name="radius" value="1"/>', "sphere"), ["<string>", "<float>"]),
        (shape('<float name="radius" value="1" unit="m"/>', "sphere"), ['no attribute "unit"']),
        (shape('<float name="radius" value="-1"/>', "sphere"), ['"radius" is -1', "above 0"]),
        (shape('<float name="radius" value="0"/>', "sphere"), ["above 0"]),
        (shape('<float name="radius" value="nan"/>', "sphere"), ['"nan" is not a finite number']),
        (shape('<float name="radius" value="inf"/>', "sphere"), ["not a finite number"]),
        (shape('<float name="radius" value="1e400"/>', "sphere"), ["too large"]),
        (shape('<float name="radius" value="1e39"/>', "sphere"), ["too large"]),
        (shape('<float name="radius" value="1_0"/>', "sphere"), ['"1_0" is not a finite number']),
        (shape('<float name="radius" value=""/>', "sphere"), ["not a finite number"]),
        (shape('<point name="center" value="1 2"/>', "sphere"), ["2 numbers", "one or three"]),
        (shape('<point name="center" x="1"/>', "sphere"), ["x, y and z"]),
        (shape('<point name="center"/>', "sphere"), ["lacks numbers"]),
        (shape('<point name="center" value="1" x="1"/>', "sphere"), ["mixes"]),
        (shape('<boolean name="flip_normals" value="yes"/>'), ["true or false"]),
        (bsdf('<rgb name="reflectance" value="1.2 0 0"/>'), ["1.2 0 0", "from 0 to 1"]),
        (bsdf('<rgb name="reflectance" value="0.5 -0.1 0"/>'), ["from 0 to 1"]),
        (bsdf('<rgb name="reflectance" value="0.5 0.5"/>'), ["2 numbers", "1 or 3"]),
        (bsdf('<rgb name="reflectance" value="red"/>'), ['"red"']),
        (bsdf('<rgb name="reflectance" value="#ff00"/>'), ["#rrggbb"]),
        (bsdf('<spectrum name="reflectance" value="400:1 700:1"/>'), ["one number", "<rgb>"]),
        (bsdf('<float name="int_ior" value="-1.5"/>', "dielectric"), ["above 0"]),
        (bsdf('<string name="int_ior" value="diamnd"/>', "dielectric"), ["did you mean diamond?"]),
        (bsdf('<rgb name="specular_transmittance" value="0.5"/>', "dielectric"), ["tinted glass"]),
        (bsdf('<string name="material" value="Cu"/>', "conductor"), ['"Cu"', "none"]),
        (bsdf('<rgb name="eta" value="0.2"/>', "conductor"), ["perfect mirror"]),
        (bsdf("", "twosided"), ["0 bsdfs", "one diffuse"]),
        (bsdf('<bsdf type="dielectric"/>', "twosided"), ["diffuse", '"dielectric"']),
        (shape('<ref id="whit"/>') + '<bsdf type="diffuse" id="white"/>', ["did you mean white?"]),
        (shape("<ref/>"), ["<ref> has no id"]),
        (shape('<ref id="lamp"/>') + '<emitter id="lamp" type="point"/>', ['"point"', '"area"']),
        ('<shape type="cube" id="a"/><shape type="cube" id="a"/>', ['id "a"', "line 5"]),
        (shape('<rgb name="radiance" value="-1"/>'), ['unknown <rgb name="radiance">']),
        (shape('<emitter type="area"><rgb name="radiance" value="-1"/></emitter>'), ["0 or more"]),
        (
            '<emitter type="point"><point name="position" value="0"/><transform name="to_world"/></emitter>',
            ["not both"],
        ),
        ('<emitter type="spot"><float name="cutoff_angle" value="0"/></emitter>', ["above 0"]),
        ('<emitter type="spot"><float name="cutoff_angle" value="120"/></emitter>', ["at most 90"]),
        ('<emitter type="spot"><float name="beam_width" value="30"/></emitter>', ["cutoff_angle, 20"]),
        (
            '<emitter type="spot"><transform name="to_world"><scale x="2"/></transform></emitter>',
            ["not stretch"],
        ),
        (moved('<matrix value="1 2 3"/>'), ["3 numbers", "16"]),
        (moved('<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1"/>'), ["last row", "0 0 0 1"]),
        (moved('<matrix value="1 0 0 0 1 0 0 0 0 0 1 0 0 0 0 1"/>'), ["determinant"]),
        (moved('<scale x="0"/>'), ["determinant"]),
        (moved('<rotate angle="3" x="0"/>'), ["axis", "0 0 0"]),
        (moved('<rotate y="2" angle="3"/>'), ["length 2", 'value="0, 1, 0"']),
        (moved('<rotate y="1"/>'), ["no angle"]),
        (moved('<translate w="1"/>'), ['no attribute "w"']),
        (moved('<lookat origin="0,0,0" target="0,0,0" up="0,1,0"/>'), ["no direction"]),
        (moved('<lookat origin="0,0,0" target="0,1,0" up="0,1,0"/>'), ["no direction"]),
        (moved('<lookat origin="0,0,0" target="0,1,0"/>'), ["no up"]),
        (moved('<float name="a" value="1"/>'), ["<float>", "inside <transform>"]),
        (moved('<scale x="2"/>', "sphere"), ["ellipsoid", "alike"]),
        (moved('<scale x="2"/>', "disk"), ["ellipse", "alike"]),
        (moved('<scale value="1e-30"/>'), ["single precision", "1e-19 to 1e19"]),
        (moved('<scale value="1e38"/>' * 3), ["single precision", "1e-19 to 1e19"]),
        (moved('<scale value="1e25"/>'), ["single precision", "1e-19 to 1e19"]),
        (moved('<scale value="1e38"/>' * 2, "sphere"), ["too large"]),
        (shape('<emitter type="area"><rgb name="radiance" value="3e38"/></emitter>'), ["too much light"]),
        ('<emitter type="point"><rgb name="intensity" value="3e38"/></emitter>', ["too bright"]),
        (shape("", "ply"), ['name="filename"']),
        (shape('<string name="filename" value="absent.ply"/>', "ply"), ['no file "absent.ply"']),
        (shape('<string name="filename" value=""/>', "ply"), ["outside the scene's folder"]),
        (shape('<string name="filename" value="../secret.ply"/>', "ply"), ["outside the scene's folder"]),
        (shape('<string name="filename" value="/etc/passwd"/>', "ply"), ["outside the scene's folder"]),
        (shape('<string name="filename" value="C:\\mesh.ply"/>', "ply"), ["outside the scene's folder"]),
        (shape('<string name="filename" value="..\\mesh.ply"/>', "ply"), ["outside the scene's folder"]),
        (shape('<string name="filename" value="."/>', "ply"), ["no file"]),
        ('<default name="a"/>', ["name and a value"]),
        (
            shape('<float name="radius" value="$missing"/>', "sphere"),
            ["$missing has no value", "-D missing="],
        ),
        (SENSOR, ["2 sensors", "line 2"]),
    ],
)
def test_refused_with_line(tmp_path: Path, body: str, words: list[str]) -> None:
    text = message(tmp_path, body)
    assert text.startswith(f"{tmp_path / 'scene.xml'}, line {FIRST_LINE}: "), text
    for word in words:
        assert word in text


def film(inside: str) -> str:
    return f'<film type="hdrfilm">{inside}</film>'


FOV = '<float name="fov" value="40"/>'


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<float name="fov" value="180"/>', ["above 0 and below 180"]),
        (FOV + '<string name="fov_axis" value="z"/>', ["smaller"]),
        ('<string name="focal_length" value="wide"/>', ["millimetres"]),
        (FOV + '<string name="focal_length" value="50mm"/>', ["not both"]),
        ('<transform name="to_world"><scale value="2"/></transform>', ["only move and rotate"]),
        ('<float name="near_clip" value="0"/>', ["above 0"]),
        ('<float name="far_clip" value="0.001"/>', ["exceed near_clip"]),
        ('<film type="ldrfilm"/>', ["did you mean hdrfilm?"]),
        (film('<integer name="width" value="0"/>'), ["from 1 to"]),
        (film('<integer name="width" value="2.5"/>'), ["whole number"]),
        (film('<float name="width" value="2"/>'), ["<integer>"]),
        (film('<integer name="crop_width" value="2"/>'), ['"crop_width"', "width"]),
        (film("") + film(""), ["one film"]),
        ('<shape type="cube"/>', ["<shape> cannot stand inside"]),
    ],
)
def test_bad_sensor(tmp_path: Path, inside: str, words: list[str]) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(f'<scene version="3.0.0">\n<sensor type="perspective">{inside}</sensor>\n{LAMP}{SHAPE}</scene>')
    text = refused(tmp_path)
    assert text.startswith(f"{file}, line 2: "), text
    for word in words:
        assert word in text


def test_unknown_sensor(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0"><sensor type="thinlens"/>{LAMP}{SHAPE}</scene>')
    assert 'unknown sensor "thinlens"; known: perspective' in refused(tmp_path)


@pytest.mark.parametrize(
    ("left", "word"), [(LAMP + SHAPE, "sensor"), (SENSOR + SHAPE, "light"), (SENSOR + LAMP, "geometry")]
)
def test_what_every_scene_needs(tmp_path: Path, left: str, word: str) -> None:
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">\n{left}</scene>')
    assert f"the scene has no {word}" in refused(tmp_path)


def test_only_dark_lights_are_no_light(tmp_path: Path) -> None:
    dark = '<emitter type="point"><rgb name="intensity" value="0"/></emitter>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{SENSOR}{SHAPE}{dark}</scene>')
    assert "no light" in refused(tmp_path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", ["line 1", "no element found"]),
        (b"\x00\x01\x02\xff" * 50, ["not well-formed"]),
        (b'<scene version="3.0.0">\n<shape>\n</scene>', ["line 3", "mismatched tag"]),
        (b'<scene version="3.0.0">', ["line 1", "not well-formed"]),
        (b'<scene version="3.0.0">\xff</scene>', ["not well-formed"]),
        (b'<?xml version="1.0" encoding="klingon"?><scene version="3.0.0"/>', ["encoding"]),
        (b'<scene version="0.6.0"/>', ['version="0.6.0"', 'version="3.0.0"']),
        (b"<scene/>", ["no version", "3.0.0"]),
        (b"<world/>", ["<world>", "<scene"]),
        (b'<scene version="3.0.0" author="me"/>', ['no attribute "author"']),
        (b'<scene version="3.0.0">' + b'<bsdf type="twosided">' * 5000, ["nested deeper"]),
        (
            b'<!DOCTYPE scene [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><scene version="3.0.0">&b;</scene>',
            ["DOCTYPE"],
        ),
        (b'<!DOCTYPE scene SYSTEM "file:///etc/passwd"><scene version="3.0.0"/>', ["DOCTYPE"]),
    ],
)
def test_bad_xml(tmp_path: Path, data: bytes, words: list[str]) -> None:
    (tmp_path / "scene.xml").write_bytes(data)
    text = refused(tmp_path)
    assert text.startswith(str(tmp_path / "scene.xml"))
    for word in words:
        assert word in text


def test_scene_that_is_not_there(tmp_path: Path) -> None:
    assert "did you mean cornell-boxes?" in refused("cornel-boxes")
    assert "no scene.xml inside" in refused(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    assert "not an .xml file" in refused(tmp_path / "notes.txt")
    assert "there is no scene" in refused(tmp_path / "absent.xml")
    assert "there is no scene" in refused("a\0b")


def test_define_that_nothing_uses(tmp_path: Path) -> None:
    body = '<default name="detail" value="1"/>' + shape('<float name="radius" value="$detail"/>', "sphere")
    assert "did you mean detail?" in message(tmp_path, body, detial="2")
    assert "no <default> at all" in message(tmp_path, "", size="2")
    assert "changes nothing" in message(tmp_path, '<default name="size" value="1"/>', size="2")


def test_bad_value_of_a_define_names_the_line_that_uses_it(tmp_path: Path) -> None:
    body = '<default name="r" value="1"/>\n' + shape('<float name="radius" value="$r"/>', "sphere")
    text = message(tmp_path, body, r="big")
    assert "line 6" in text
    assert '"big" is not a finite number' in text


def test_symlink_out_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.ply").write_text("ply")
    inside = tmp_path / "scene"
    inside.mkdir()
    (inside / "mesh.ply").symlink_to(tmp_path / "secret.ply")
    (inside / "loop.ply").symlink_to(inside / "loop.ply")
    filename = '<string name="filename" value="{}"/>'
    assert "leads outside" in message(inside, shape(filename.format("mesh.ply"), "ply"))
    assert "loop.ply" in message(inside, shape(filename.format("loop.ply"), "ply"))
