"""Scenes packed for the browser: decoded again within the quantization error, and within the size budget."""

import base64
import dataclasses
import io
import json
import warnings
import zlib

import numpy as np
import pytest
import zoo
from PIL import Image

from mimesh.core.errors import InputError
from mimesh.core.geometry import border_edges, vertex_normals
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.view.pack import (
    DENSE_VERTICES,
    MotionLimits,
    Panel,
    TextureStore,
    pack_scene,
    simplify_clip,
    split_vertices,
    subset,
)
from mimesh.view.textures import decode_image


def inflate(text):
    """Decode base64 and deflate to bytes."""
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)


def decode_differences(planes, dtype):
    """Decode zigzag differences from planes of bytes."""
    values = np.ascontiguousarray(planes.reshape(np.dtype(dtype).itemsize, -1).T).view(dtype).ravel()
    return (values >> 1) ^ (0 - (values & 1)).astype(dtype)


def unpack(packed):
    """Decode an array; the naive twin of `unpack` in web/player/scene.js."""
    planes = inflate(packed["data"])
    if packed["type"] == "f32":
        return np.ascontiguousarray(planes.reshape(4, -1).T).view("<f4").reshape(packed["shape"])
    return np.cumsum(decode_differences(planes, "<u4"), dtype=np.uint32).reshape(packed["shape"])


def decode_frames(panel):
    """Decode positions (T, V, 3); the naive twin of `Panel` in web/player/scene.js."""
    coded = inflate(panel["stream"]).reshape(panel["frames"], -1)
    steps = np.stack([decode_differences(frame, "<u2") for frame in coded])
    steps[0] = np.cumsum(steps[0], dtype=np.uint16)
    steps = np.cumsum(steps, axis=0, dtype=np.uint16).reshape(panel["frames"], 3, -1).transpose(0, 2, 1)
    if panel["index"] is not None:
        steps = steps[:, unpack(panel["index"])]
    centre = np.reshape(panel["centre"], (-1, 1, 3))
    return centre + np.array(panel["low"]) + panel["unit"] * steps


def png():
    """Encode a small black picture."""
    return encode(Image.new("RGB", (2, 2)), "PNG")


def random_clip(mesh, count=7, seed=0):
    """Make a clip of a mesh that travels and deforms at random."""
    rng = np.random.default_rng(seed)
    offsets = np.cumsum(rng.normal(size=(count, 1, 3)), axis=0) + 0.02 * rng.normal(size=(count, len(mesh.vertices), 3))
    return Clip(mesh, mesh.vertices + offsets, 24.0)


@pytest.mark.parametrize("make", zoo.ZOO, ids=lambda make: make.__name__)
def test_positions_are_decoded_within_half_a_step(make):
    """Split vertices are those of the faces, and the same input gives the same scene."""
    clip = random_clip(make())
    scene = pack_scene([Panel("mesh", clip)])
    panel = scene["panels"][0]
    largest = max(np.ptp(clip.vertices[t], axis=0).max() for t in range(len(clip)))
    assert panel["unit"] < 1.2 * largest / 65535
    assert np.abs(decode_frames(panel) - clip.vertices).max() <= 0.501 * panel["unit"]
    surface = scene["surfaces"][0]
    corners, origin = unpack(surface["corners"]), unpack(surface["origin"])
    if len(clip.mesh.faces):
        np.testing.assert_array_equal(origin[corners], clip.mesh.faces)
    assert (np.diff(origin.astype(int)) >= 0).all()
    assert json.dumps(pack_scene([Panel("mesh", clip)])) == json.dumps(scene)


def test_a_cube_has_hard_edges_and_a_sheet_is_smooth_across_its_seams():
    assert len(split_vertices(zoo.cube()).origin) == 24
    assert len(split_vertices(zoo.grid()).origin) == 25
    sheet = zoo.grid(3)
    unwelded = Mesh(sheet.vertices[sheet.faces].reshape(-1, 3), np.arange(3 * len(sheet.faces)).reshape(-1, 3))
    assert split_vertices(unwelded).smooth.max() + 1 == 9


def test_vertices_are_split_where_texture_coordinates_differ():
    sheet = zoo.grid(3)
    uv = sheet.vertices[sheet.faces][..., :2].astype(float)
    uv[0] += 5.0
    textured = (Part("all", 0, len(sheet.faces), Material("paint", texture=png())),)
    split = split_vertices(dataclasses.replace(sheet, corner_uv=uv, parts=textured))
    assert len(split.origin) == 9 + 3
    np.testing.assert_allclose(split.uv[split.corners], uv)
    assert len(np.unique(split.smooth)) == 9  # a seam of the texture is no hard edge


def test_damaged_textures_are_left_out_and_counted():
    cube = zoo.cube()
    uv = np.zeros((len(cube.faces), 3, 2))
    broken = (Part("all", 0, len(cube.faces), Material("paint", texture=b"\x89PNG broken")),)
    scene = pack_scene([Panel("mesh", Clip.still(dataclasses.replace(cube, corner_uv=uv, parts=broken)))])
    assert scene["images"] == []
    assert scene["surfaces"][0]["groups"][0]["material"]["image"] is None
    assert scene["left_out"] == ["textures that cannot be read are left out: 1"]


def test_identity_and_result_share_one_surface():
    mesh = zoo.cube()
    panels = [
        Panel("identity", Clip.still(mesh)),
        Panel("driving", random_clip(zoo.grid())),
        Panel("result", random_clip(mesh)),
    ]
    scene = pack_scene(panels)
    assert [panel["surface"] for panel in scene["panels"]] == [0, 1, 0]
    assert scene["panels"][0]["size"] == scene["panels"][2]["size"]


def test_files_that_are_compared_keep_their_own_hard_edges():
    flat, smooth = zoo.cube(), zoo.cube()
    normals = vertex_normals(smooth.vertices, smooth.faces)[smooth.faces]
    panels = [
        Panel("mesh", Clip.still(mesh)) for mesh in (flat, dataclasses.replace(smooth, corner_normals=normals), flat)
    ]
    scene = pack_scene(panels)
    assert [panel["surface"] for panel in scene["panels"]] == [0, 1, 0]
    assert [surface["origin"]["shape"] for surface in scene["surfaces"]] == [[24], [8]]


def test_frames_of_long_clips_are_dropped_to_meet_the_budget_with_a_message():
    clip = random_clip(zoo.grid(20), 301)
    whole = pack_scene([Panel("mesh", clip)])
    assert whole["left_out"] == []
    small = pack_scene([Panel("mesh", clip)], budget=100_000)
    assert len(json.dumps(small)) < 110_000
    panel = small["panels"][0]
    step = round(clip.fps / panel["fps"])
    assert small["left_out"][0].startswith(f"every {step}")
    assert "of 301 frames" in small["left_out"][0]
    assert np.abs(decode_frames(panel) - clip.vertices[::step]).max() <= 0.501 * panel["unit"]


def test_frames_beyond_a_largest_number_are_dropped():
    clip = random_clip(zoo.cube(), 301)
    scene = pack_scene([Panel("mesh", clip)], motion=MotionLimits(frames=100))
    panel = scene["panels"][0]
    assert panel["frames"] == 76
    assert scene["left_out"] == ["every 4th of 301 frames is shown, to keep this page small"]
    small = pack_scene([Panel("mesh", clip)], motion=MotionLimits(frames=100, characters=2000))["panels"][0]
    assert len(small["stream"]) < 2500
    assert np.isclose(clip.fps / small["fps"] % 4, 0)


def test_vertices_that_move_alike_are_stored_once():
    mesh = zoo.cube()
    clip = random_clip(mesh, 20)
    twice = np.concatenate([clip.vertices, clip.vertices], axis=1)
    twice[9, 8] += 1.0  # equal to the first vertex in all frames but one
    double = dataclasses.replace(mesh, vertices=twice[0], faces=np.concatenate([mesh.faces, mesh.faces + 8]))
    panel = pack_scene([Panel("mesh", Clip(double, twice, 24.0))])["panels"][0]
    assert panel["index"]["shape"] == [16]
    assert len(np.unique(unpack(panel["index"]))) == 9
    assert np.abs(decode_frames(panel) - twice).max() <= 0.501 * panel["unit"]


def test_very_dense_meshes_are_simplified_alike_with_a_message():
    mesh = zoo.grid(60)
    mesh = dataclasses.replace(mesh, faces=mesh.faces[np.argsort(mesh.vertices[mesh.faces].mean(axis=1)[:, 0])])
    half = len(mesh.faces) // 2
    paint = [
        Material(name, (*color, 1.0), png()) for name, color in (("red", (1.0, 0.0, 0.0)), ("blue", (0.0, 0.0, 1.0)))
    ]
    parts = (Part("a", 0, half, paint[0]), Part("b", half, len(mesh.faces), paint[1]))
    uv = np.zeros((len(mesh.faces), 3, 2))
    mesh = dataclasses.replace(mesh, parts=parts, corner_uv=uv, vertex_colors=np.ones((len(mesh.vertices), 4)))
    clip = random_clip(mesh, 3)
    panels = [Panel("identity", Clip.still(mesh)), Panel("result", clip)]
    scene = pack_scene(panels, motion=MotionLimits(vertices=600))
    shown = scene["panels"][0]["vertices"]
    assert 300 < shown < 900
    message = f"{shown:,} of {len(mesh.vertices):,} vertices are shown, to keep this page small, without textures"
    assert scene["left_out"] == [message]
    assert [panel["surface"] for panel in scene["panels"]] == [0, 0]  # identity and result keep the same vertices
    groups = scene["surfaces"][0]["groups"]
    assert [group["material"]["color"][0] for group in groups] == [1.0, 0.0]
    assert groups[0]["stop"] == groups[1]["start"]
    assert groups[1]["stop"] == scene["panels"][0]["triangles"]
    assert scene["images"] == []
    assert unpack(scene["surfaces"][0]["colors"]).shape == (shown, 4)
    positions = decode_frames(scene["panels"][1])
    distance = np.linalg.norm(positions[2][:, None] - clip.vertices[2], axis=-1).min(axis=1)
    assert distance.max() < 2 * scene["panels"][1]["unit"]


def test_a_page_has_its_size_whatever_the_mesh():
    mesh = zoo.grid(100)
    mesh = mesh.with_vertices(mesh.vertices + np.random.default_rng(0).normal(scale=1e-3, size=mesh.vertices.shape))
    whole, small = (
        len(json.dumps(pack_scene([Panel("mesh", Clip.still(mesh))], budget=size))) for size in (8_000_000, 40_000)
    )
    assert whole > 40_000 > small


def test_simplified_surfaces_do_not_open_at_seams():
    sheet = zoo.grid(40)
    unwelded, split = sheet.vertices[sheet.faces].reshape(-1, 3), np.arange(3 * len(sheet.faces)).reshape(-1, 3)
    chosen, faces = subset(unwelded, split, 400)
    sides = len(border_edges(faces))
    assert 100 < len(chosen) < 700
    assert sides < len(faces) / 2  # apart, every face would have three


def test_simplified_clips_and_clouds_have_vertices_of_the_original():
    clip = random_clip(zoo.grid(60), 3)
    simplified = simplify_clip(clip, 500)
    assert 250 < len(simplified.mesh.vertices) < 750
    for t in range(3):
        assert set(map(tuple, simplified.vertices[t])) <= set(map(tuple, clip.vertices[t].astype(np.float32)))
    assert DENSE_VERTICES > 6890  # bodies are not simplified
    chosen, faces = subset(clip.mesh.vertices, np.zeros((0, 3), np.int64), 100)
    assert (len(chosen), len(faces)) == (100, 0)
    assert np.diff(chosen).max() <= len(clip.mesh.vertices) // 100 + 1


@pytest.mark.parametrize(("panels", "message"), [([], "at least one mesh"), (["hero"], "a role of identity")])
def test_no_panels_and_unknown_roles_are_refused(panels, message):
    with pytest.raises(InputError, match=message):
        pack_scene([Panel(role, Clip.still(zoo.cube())) for role in panels])


RAMP = np.arange(256, dtype=np.uint8).reshape(16, 16)


def encode(image, suffix, **options):
    """Encode an image in a file format."""
    content = io.BytesIO()
    image.save(content, suffix, **options)
    return content.getvalue()


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGB", "RGBA"])
def test_grey_in_any_mode_is_grey(mode):
    image = decode_image(encode(Image.fromarray(RAMP).convert(mode), "PNG"))
    np.testing.assert_array_equal(np.asarray(image), np.repeat(RAMP[..., None], 3, axis=2))


@pytest.mark.parametrize("content", [b"", b"\x89PNG nothing", encode(Image.fromarray(RAMP), "JPEG")[:150]])
def test_damaged_files_give_none(content):
    assert decode_image(content) is None


def test_large_textures_are_halved_until_they_fit():
    noise = np.random.default_rng(0).integers(0, 256, (1024, 1024, 3), dtype=np.uint8)
    store, left_out = TextureStore(), []
    assert store.index(encode(Image.fromarray(noise), "PNG")) == 0
    (packed,) = store.pack(400_000, left_out)
    assert packed["type"] == "image/jpeg"
    assert len(packed["data"]) <= 400_000
    assert left_out == ["textures are shown smaller than they are, to keep this page small"]


def test_unusual_pictures_are_converted():
    """Grey of 16 bits, CMYK, and a palette with transparency, without a warning."""
    grey = decode_image(encode(Image.fromarray(RAMP.astype(np.uint16) * 257), "PNG"))
    np.testing.assert_array_equal(np.asarray(grey)[..., 1], RAMP)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert decode_image(encode(Image.fromarray(RAMP).convert("P"), "PNG", transparency=b"\x00\x80")) is not None
    red = decode_image(encode(Image.new("CMYK", (8, 8), (0, 255, 255, 0)), "JPEG"))
    assert np.asarray(red).reshape(-1, 3).mean(axis=0) == pytest.approx([255, 0, 0], abs=12)
