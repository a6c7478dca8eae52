"""Scenes packed for the browser: what is read back is what was shown, within the quantisation, and never too large."""

import base64
import dataclasses
import io
import json
import zlib

import numpy as np
import pytest
import zoo
from PIL import Image

from mimesh.core.errors import InputError
from mimesh.core.geometry import vertex_normals
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.player.pack import Panel, pack_scene
from mimesh.player.split_vertices import split_vertices
from mimesh.player.thinning import DENSE, simplified


def inflated(text):
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)


def unsigned(planes, dtype):
    """Bytes in planes, and small numbers of either sign, back to differences."""
    values = np.ascontiguousarray(planes.reshape(np.dtype(dtype).itemsize, -1).T).view(dtype).ravel()
    return (values >> 1) ^ (0 - (values & 1)).astype(dtype)


def unpacked(packed):
    """The naive twin of `unpack` in web/player/scene.js."""
    planes = inflated(packed["data"])
    if packed["type"] == "f32":
        return np.ascontiguousarray(planes.reshape(4, -1).T).view("<f4").reshape(packed["shape"])
    return np.cumsum(unsigned(planes, "<u4"), dtype=np.uint32).reshape(packed["shape"])


def frames(panel):
    """The naive twin of `Panel` in web/player/scene.js: (T, V, 3)."""
    coded = inflated(panel["stream"]).reshape(panel["frames"], -1)
    steps = np.stack([unsigned(frame, "<u2") for frame in coded])
    steps[0] = np.cumsum(steps[0], dtype=np.uint16)
    steps = np.cumsum(steps, axis=0, dtype=np.uint16).reshape(panel["frames"], 3, -1).transpose(0, 2, 1)
    centre = np.reshape(panel["centre"], (-1, 1, 3))
    return centre + np.array(panel["low"]) + panel["unit"] * steps


def png():
    content = io.BytesIO()
    Image.new("RGB", (2, 2)).save(content, "PNG")
    return content.getvalue()


def moving(mesh, count=7, seed=0):
    rng = np.random.default_rng(seed)
    offsets = np.cumsum(rng.normal(size=(count, 1, 3)), axis=0) + 0.02 * rng.normal(size=(count, len(mesh.vertices), 3))
    return Clip(mesh, mesh.vertices + offsets, 24.0)


@pytest.mark.parametrize("make", zoo.ZOO, ids=lambda make: make.__name__)
def test_positions_come_back_within_half_a_step(make):
    clip = moving(make())
    panel = pack_scene([Panel("mesh", clip)])["panels"][0]
    largest = max(np.ptp(clip.vertices[t], axis=0).max() for t in range(len(clip)))
    assert panel["unit"] < 1.2 * largest / 65535
    assert np.abs(frames(panel) - clip.vertices).max() <= 0.501 * panel["unit"]


@pytest.mark.parametrize("make", zoo.ZOO, ids=lambda make: make.__name__)
def test_split_vertices_are_still_those_of_the_faces(make):
    mesh = make()
    surface = pack_scene([Panel("mesh", Clip.still(mesh))])["surfaces"][0]
    corners, origin = unpacked(surface["corners"]), unpacked(surface["origin"])
    if len(mesh.faces):
        np.testing.assert_array_equal(origin[corners], mesh.faces)
    assert (np.diff(origin.astype(int)) >= 0).all()


def test_a_cube_has_hard_edges_and_a_sheet_is_smooth():
    assert len(split_vertices(zoo.cube()).origin) == 24
    assert len(split_vertices(zoo.grid()).origin) == 25


def test_vertices_are_split_where_texture_coordinates_part():
    sheet = zoo.grid(3)
    uv = sheet.vertices[sheet.faces][..., :2].astype(float)
    uv[0] += 5.0
    painted = (Part("all", 0, len(sheet.faces), Material("paint", texture=png())),)
    split = split_vertices(dataclasses.replace(sheet, corner_uv=uv, parts=painted))
    assert len(split.origin) == 9 + 3
    np.testing.assert_allclose(split.uv[split.corners], uv)
    assert len(np.unique(split.smooth)) == 9  # a seam of the texture is no hard edge


def test_pictures_that_cannot_be_read_are_left_out_and_counted():
    cube = zoo.cube()
    uv = np.zeros((len(cube.faces), 3, 2))
    broken = (Part("all", 0, len(cube.faces), Material("paint", texture=b"\x89PNG broken")),)
    scene = pack_scene([Panel("mesh", Clip.still(dataclasses.replace(cube, corner_uv=uv, parts=broken)))])
    assert scene["images"] == []
    assert scene["surfaces"][0]["groups"][0]["material"]["image"] is None
    assert scene["left_out"] == ["textures that cannot be read are left out: 1"]


def test_split_files_are_smooth_across_their_seams():
    sheet = zoo.grid(3)
    soup = Mesh(sheet.vertices[sheet.faces].reshape(-1, 3), np.arange(3 * len(sheet.faces)).reshape(-1, 3))
    assert split_vertices(soup).smooth.max() + 1 == 9


def test_identity_and_result_share_one_surface():
    mesh = zoo.cube()
    shown = [Panel("identity", Clip.still(mesh)), Panel("driving", moving(zoo.grid())), Panel("result", moving(mesh))]
    scene = pack_scene(shown)
    assert [panel["surface"] for panel in scene["panels"]] == [0, 1, 0]
    assert scene["panels"][0]["size"] == scene["panels"][2]["size"]


def test_files_that_are_compared_keep_their_own_hard_edges():
    flat, soft = zoo.cube(), zoo.cube()
    normals = vertex_normals(soft.vertices, soft.faces)[soft.faces]
    shown = [
        Panel("mesh", Clip.still(mesh)) for mesh in (flat, dataclasses.replace(soft, corner_normals=normals), flat)
    ]
    scene = pack_scene(shown)
    assert [panel["surface"] for panel in scene["panels"]] == [0, 1, 0]
    assert [surface["origin"]["shape"] for surface in scene["surfaces"]] == [[24], [8]]


def test_long_clips_are_thinned_to_the_budget_and_the_page_says_so():
    clip = moving(zoo.grid(20), 301)
    whole = pack_scene([Panel("mesh", clip)])
    assert whole["left_out"] == []
    small = pack_scene([Panel("mesh", clip)], budget=100_000)
    assert len(json.dumps(small)) < 110_000
    panel = small["panels"][0]
    step = round(clip.fps / panel["fps"])
    assert small["left_out"][0].startswith(f"every {step}")
    assert "of 301 frames" in small["left_out"][0]
    assert np.abs(frames(panel) - clip.vertices[::step]).max() <= 0.501 * panel["unit"]


def test_a_dense_clip_is_simplified_to_points_of_its_own():
    clip = moving(zoo.grid(60), 3)
    light = simplified(clip, 500)
    assert 250 < len(light.mesh.vertices) < 750
    for t in range(3):
        assert set(map(tuple, light.vertices[t])) <= set(map(tuple, clip.vertices[t].astype(np.float32)))
    assert DENSE > 6890  # people are shown as they are


def test_the_same_input_gives_the_same_scene():
    shown = [Panel("identity", Clip.still(zoo.cube())), Panel("result", moving(zoo.cube()))]
    assert json.dumps(pack_scene(shown)) == json.dumps(pack_scene(shown))


def test_what_cannot_be_shown_is_refused():
    with pytest.raises(InputError, match="at least one mesh"):
        pack_scene([])
    with pytest.raises(InputError, match="a role of identity"):
        pack_scene([Panel("hero", Clip.still(zoo.cube()))])
