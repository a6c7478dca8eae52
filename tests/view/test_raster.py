"""Whole pictures: invariances, cameras, materials, and colours where they are known."""

import dataclasses
import io

import numpy as np
import pytest
import zoo
from PIL import Image

from mimesh.core.errors import InputError
from mimesh.core.mesh import Material, Mesh, Part, permute_vertices
from mimesh.io.colors import to_linear, to_srgb
from mimesh.view import shading, textures
from mimesh.view.camera import VIEWS, extreme_points, fit, follow, orbit, rotate_camera
from mimesh.view.raster import render, render_mesh

SIZE = (72, 64)
SOLID = [m for m in zoo.ZOO if m is not zoo.point_cloud]


def draw(mesh, **options):
    return render(mesh.vertices, mesh.faces, fit(mesh.vertices, SIZE), SIZE, **options)


def assert_same_picture(a, b):
    """Equal up to the last bit of a channel, which the order of a sum may change."""
    assert np.abs(a.astype(int) - b.astype(int)).max() <= 1


def foreground(picture):
    return (picture != shading.to_pixels(np.sqrt(to_linear(np.array([[shading.BACKGROUND]]))))).any(axis=2)


@pytest.mark.parametrize("make", zoo.ZOO)
def test_what_does_not_change_a_picture(make):
    """Drawing again, moving or scaling mesh and camera together; the order of faces and vertices, and turned faces."""
    mesh, rng = make(), np.random.default_rng(1)
    before, picture = mesh.vertices.copy(), draw(mesh)
    assert picture.shape == (64, 72, 3)
    assert foreground(picture).any()
    np.testing.assert_array_equal(draw(mesh), picture)
    np.testing.assert_array_equal(mesh.vertices, before)
    assert_same_picture(draw(mesh.with_vertices(mesh.vertices + [512.0, -64.0, 8.0])), picture)
    assert_same_picture(draw(mesh.with_vertices(mesh.vertices * 4)), picture)
    if len(mesh.faces):
        assert_same_picture(draw(dataclasses.replace(mesh, faces=rng.permutation(mesh.faces))), picture)
        assert_same_picture(draw(permute_vertices(mesh, rng.permutation(len(mesh.vertices)))), picture)
        assert_same_picture(draw(dataclasses.replace(mesh, faces=mesh.faces[:, ::-1])), picture)
        turned_up = np.stack([mesh.vertices[:, 0], -mesh.vertices[:, 2], mesh.vertices[:, 1]], axis=1)
        assert_same_picture(render(turned_up, mesh.faces, fit(turned_up, SIZE, up="z"), SIZE), picture)
        split = Mesh(mesh.vertices[mesh.faces.ravel()], np.arange(mesh.faces.size).reshape(-1, 3))
        assert_same_picture(draw(split), picture)  # no seam


def test_a_face_across_the_whole_picture_is_one_even_colour():
    vertices = np.array([[-9.0, -9, 0], [9, -9, 0], [0, 20, 0]])
    camera = fit(np.array([[-1.0, -1, 0], [1, 1, 0]]), SIZE, (0.0, 0.0))
    picture = render(vertices, np.array([[0, 1, 2]]), camera, SIZE, np.array([0.2, 0.5, 0.8]), shadows=False)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) == 1
    assert (np.diff(picture[0, 0].astype(int)) > 20).all()


@pytest.mark.parametrize("supersample", [1, 2, 4])
def test_edges_are_smoothed_by_the_share_of_the_pixel_they_cover(supersample):
    vertices = np.array([[-0.83, -0.71, 0], [0.77, -0.52, 0], [0.13, 0.89, 0]])
    camera = fit(vertices, SIZE, (0.0, 0.0))
    black, white = np.zeros(3), (1.0, 1.0, 1.0)
    options = {"supersample": supersample, "shadows": False, "background": white}
    picture = render(vertices, np.array([[0, 1, 2]]), camera, SIZE, black, **options)
    x, y, _ = camera.project(vertices, SIZE).T
    area = abs((x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])) / 2
    root = np.sqrt(to_linear(picture[..., 0] / 255.0))
    covered = (1 - root).sum() / (1 - root.min())
    assert covered == pytest.approx(area, rel=0.03 / supersample)
    assert len(np.unique(picture[..., 0])) <= supersample**2 + 1


def test_vertex_colours_are_mixed_in_perspective():
    """The middle of a receding strip's picture lies nearer than the middle of the strip."""
    vertices = np.array([[-1.0, 0, 0], [1, 0, 0], [1, 0, -8], [-1, 0, -8]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    camera = fit(vertices, SIZE, (0.0, 30.0))
    rows = camera.project(np.array([[0.0, 0, 0], [0, 0, -4], [0, 0, -8]]), SIZE)[:, 1]
    colors = np.array([[0.0, 0, 0], [0, 0, 0], [1, 1, 1], [1, 1, 1]]) * 0.5
    picture = to_linear(render(vertices, faces, camera, SIZE, colors, shadows=False) / 255.0)[..., 0]
    near, middle, far = (picture[round(row), SIZE[0] // 2] for row in rows + [-2, 0, 2])
    assert middle == pytest.approx((near + far) / 2, rel=0.1)


def test_shadows_darken_the_floor_and_nothing_else_of_the_background():
    mesh = zoo.cube()
    with_shadow, without = draw(mesh), draw(mesh, shadows=False)
    assert foreground(with_shadow).sum() > foreground(without).sum() + 100
    assert (with_shadow.astype(int) <= without.astype(int) + 1).all()
    assert_same_picture(with_shadow[[0, -1]], without[[0, -1]])
    camera = fit(mesh.vertices, SIZE, (20.0, -10.0))  # looks up
    pictures = (render(mesh.vertices, mesh.faces, camera, SIZE, shadows=on) for on in (True, False))
    np.testing.assert_array_equal(*pictures)


def test_meshes_behind_the_camera_are_left_out():
    mesh = zoo.cube()
    camera = fit(mesh.vertices, SIZE)
    behind = camera.eye + (camera.eye - camera.centre)
    picture = render(mesh.vertices + behind - camera.centre, mesh.faces, camera, SIZE, shadows=False)
    assert not foreground(picture).any()


def test_point_clouds_take_colours():
    cloud = zoo.point_cloud()
    red = draw(cloud, colors=np.tile([0.9, 0.1, 0.1], (50, 1)), shadows=False)
    drawn = red[foreground(red)].astype(int)
    assert len(drawn) > 100
    assert (drawn[:, 0] > drawn[:, 1]).all()
    one = Mesh(np.zeros((1, 3)), np.zeros((0, 3), int))
    assert foreground(draw(one)).any()


def quad(material, faces=((0, 1, 2), (0, 2, 3))):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    parts = (Part("quad", 0, len(faces), material),)
    return Mesh(vertices, np.array(faces), corner_uv=vertices[np.array(faces)][..., :2], parts=parts)


def test_a_texture_lies_the_right_way_up_and_multiplies_the_base_colour():
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    content = io.BytesIO()
    Image.fromarray(pixels).resize((64, 64), Image.Resampling.NEAREST).save(content, "png")
    mesh = quad(Material("paint", (1.0, 1.0, 0.5, 1.0), content.getvalue()))
    picture = render_mesh(mesh, (64, 64), fit(mesh.vertices, (64, 64), (0.0, 0.0)), shadows=False).astype(int)
    upper_left, upper_right, lower_left, lower_right = (picture[y, x] for y in (20, 44) for x in (20, 44))
    assert upper_left.argmax() == 0
    assert upper_right.argmax() == 1
    assert lower_left.argmax() == 2
    assert lower_right[0] > lower_right[2] + 20  # white through a yellowish base colour
    assert upper_left[0] > lower_left[2] + 20


def test_parts_have_their_own_colours_and_clay_leaves_them_out():
    red, blue = (
        Material(name, color) for name, color in (("red", (0.8, 0.0, 0.0, 1.0)), ("blue", (0.0, 0.0, 0.8, 1.0)))
    )
    mesh = dataclasses.replace(quad(red), parts=(Part("a", 0, 1, red), Part("b", 1, 2, blue)))
    camera = fit(mesh.vertices, SIZE, (0.0, 0.0))
    picture = render_mesh(mesh, SIZE, camera, shadows=False).astype(int)
    assert picture[40, 48].argmax() == 0
    assert picture[20, 24].argmax() == 2
    plain = render(mesh.vertices, mesh.faces, camera, SIZE, shadows=False)
    np.testing.assert_array_equal(render_mesh(mesh, SIZE, camera, clay=True, shadows=False), plain)


def test_a_part_without_material_is_clay():
    mesh = dataclasses.replace(quad(Material("red")), parts=(Part("a", 0, 1, Material("red")), Part("b", 1, 2)))
    surface = textures.materials(mesh)
    assert surface is not None
    assert textures.materials(dataclasses.replace(mesh, parts=(Part("b", 0, 2),))) is None
    camera = fit(mesh.vertices, SIZE, (0.0, 0.0))
    mixed = render_mesh(mesh, SIZE, camera, shadows=False)
    plain = render_mesh(mesh, SIZE, camera, clay=True, shadows=False)
    assert_same_picture(mixed[20, 24], plain[20, 24])


def test_creases_stay_hard_and_smooth_surfaces_smooth():
    cube = zoo.cube()
    normals = textures.creased_normals(cube.vertices, cube.faces)
    np.testing.assert_allclose(np.abs(normals).max(axis=2), 1.0)
    angle = np.linspace(0, np.pi, 13)
    arc = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([arc, arc + [0, 0, 1]])
    faces = np.array([f for k in range(12) for f in ((k, k + 1, k + 14), (k, k + 14, k + 13))])
    smooth = textures.creased_normals(vertices, faces)
    inner = (faces % 13 > 0) & (faces % 13 < 12)
    radial = vertices[faces] * [1, 1, 0]
    np.testing.assert_allclose(np.abs((smooth * radial).sum(axis=2))[inner], 1.0, atol=0.01)


@pytest.mark.parametrize("view", [*VIEWS, (17.0, 44.0)])
def test_a_fitted_camera_fills_the_picture_and_no_more(view):
    points = np.random.default_rng(3).normal(size=(2, 40, 3)) + [5, 2, -9]
    camera = fit(points, (300, 200), view, margin=0.1)
    x, y, _ = camera.project(points.reshape(-1, 3), (300, 200)).T
    low, high = np.array([x.min() / 300, y.min() / 200]), np.array([x.max() / 300, y.max() / 200])
    assert low.min() >= 0.1 - 1e-9
    assert high.max() <= 0.9 + 1e-9
    np.testing.assert_allclose(low + high, 1.0, atol=0.15)


def test_the_front_is_seen_from_the_front_and_the_side_faces_right():
    nose = np.array([[0.0, 0, 1], [0, 0, -1], [0.2, 1, 0], [-0.2, 1, 0]])
    front = fit(nose, SIZE, "front").project(nose, SIZE)
    assert front[0, 2] < front[1, 2]  # nearer
    assert front[2, 0] > front[3, 0]  # +x is on the right
    side = fit(nose, SIZE, "side").project(nose, SIZE)
    assert side[0, 0] > side[1, 0]
    top = fit(nose, SIZE, "top").project(nose, SIZE)
    assert top[2, 2] < top[0, 2]
    assert top[0, 1] > top[1, 1]  # the front is at the lower edge


def test_an_orbit_keeps_the_subject_in_the_picture_from_everywhere():
    mesh = zoo.two_parts()
    cameras = orbit(mesh.vertices, SIZE, 12)
    for camera in cameras:
        x, y, _ = camera.project(mesh.vertices, SIZE).T
        assert min(x.min(), y.min()) > 0
        assert (x.max() < SIZE[0]) & (y.max() < SIZE[1])
    np.testing.assert_allclose(rotate_camera(cameras[-1], 30.0).eye, cameras[0].eye, atol=1e-9)
    upright = np.array([[0.0, 0, 0], [0, 1, 0]]) + cameras[0].centre
    heights = [np.ptp(camera.project(upright, SIZE)[:, 1]) for camera in cameras]
    np.testing.assert_allclose(heights, heights[0], rtol=1e-9)


@pytest.mark.parametrize("view", ["three-quarter", "top"])
def test_extreme_points_give_the_camera_of_the_whole_clip(view):
    clip = np.random.default_rng(4).normal(size=(5, 30, 3)) + [3, 0, 1]
    whole, extreme = fit(clip, (300, 200), view), fit(extreme_points(clip, (300, 200), view), (300, 200), view)
    np.testing.assert_allclose(extreme.eye, whole.eye, atol=1e-9)
    np.testing.assert_allclose([extreme.floor, extreme.radius], [whole.floor, whole.radius], atol=1e-9)


def test_a_transparent_picture_over_a_background_is_the_picture_on_it():
    mesh = zoo.two_parts()
    layers = draw(mesh, background=None).astype(float)
    paper, alpha = np.array(shading.BACKGROUND) * 255, layers[..., 3:] / 255
    over = layers[..., :3] * alpha + paper * (1 - alpha)
    # Edges and shadows are mixed in sRGB here, in square roots of linear light by the renderer.
    assert np.abs(over - draw(mesh)).max() < 8
    assert layers[0, 0, 3] == 0


def test_vertex_colours_multiply_the_material_and_tint_and_clay_leave_them_out():
    blue = np.tile([0.1, 0.2, 0.9, 1.0], (4, 1))
    mesh = dataclasses.replace(quad(None), vertex_colors=blue)
    camera = fit(mesh.vertices, SIZE, (0.0, 0.0))
    assert render_mesh(mesh, SIZE, camera, shadows=False)[32, 36].argmax() == 2
    assert render_mesh(mesh, SIZE, camera, shadows=False, clay=True)[32, 36].argmax() == 0
    assert render_mesh(mesh, SIZE, camera, shadows=False, tint=(0.2, 0.9, 0.2))[32, 36].argmax() == 1
    cloud = Mesh(mesh.vertices, np.zeros((0, 3), int), vertex_colors=blue)
    picture = render_mesh(cloud, SIZE, camera, shadows=False)
    assert (picture[foreground(picture)].argmax(axis=1) == 2).mean() > 0.9


def test_a_fine_texture_seen_from_afar_is_its_mean():
    """Black and white texels of a thirtieth of a pixel: grey, without a pattern."""
    board = (np.indices((1024, 1024)).sum(axis=0) % 2 * 255).astype(np.uint8)
    content = io.BytesIO()
    Image.fromarray(board).convert("RGB").save(content, "png")
    mesh = quad(Material("board", (1.0, 1.0, 1.0, 1.0), content.getvalue()))
    picture = render_mesh(mesh, SIZE, fit(mesh.vertices, SIZE, (0.0, 0.0)), shadows=False)
    assert np.ptp(picture[24:40, 28:44].astype(int), axis=(0, 1)).max() < 12


def test_a_following_camera_keeps_a_translated_mesh_in_place():
    mesh = zoo.cube()
    travel = np.array([[0.0, 0, 0], [3, 0, 1], [5, 0, 2]])
    points = mesh.vertices + travel[:, None]
    projected = [camera.project(frame, SIZE) for camera, frame in zip(follow(points, SIZE), points, strict=True)]
    np.testing.assert_allclose(projected[1], projected[0], atol=1e-9)
    np.testing.assert_allclose(projected[2], projected[0], atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"view": "behind"}, "view: expected one of three-quarter"),
        ({"up": "w"}, "up: expected x, y, z"),
        ({"up": "+"}, "up: expected x, y, z"),
        ({"up": "z", "front": "-z"}, "front: expected an axis across up"),
    ],
)
def test_unknown_views_and_axes_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        fit(zoo.cube().vertices, SIZE, **options)


def test_srgb_and_linear_undo_each_other():
    values = np.linspace(0, 1, 50).reshape(-1, 1)
    np.testing.assert_allclose(to_srgb(to_linear(values)), values, atol=1e-9)
