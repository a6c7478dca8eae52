"""FBX files become glTF in memory: geometry, skins, blend shapes, materials and animations are those of the file."""

import io

import fbx_samples as samples
import numpy as np
import pytest
from PIL import Image
from rigs import read_skin

from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.beside import confined
from mimesh.io.gltf.animation import animation_names, read_channels
from mimesh.io.gltf.document import open_document, read_floats

pytestmark = pytest.mark.usefixtures("in_process")

pytest.importorskip("ufbx")
METRE = 0.01
"""Metres of the unit of files that state none: a centimetre."""


def at(path, file=None, **options):
    return samples.arm(file, **options).save(path / "arm.fbx")


def by_position(mesh):
    """Return the distinct positions of a mesh, sorted."""
    return np.unique(mesh.vertices.round(9), axis=0)


def test_mesh_has_the_positions_polygons_and_names_of_the_file(tmp_path):
    mesh = load_mesh(at(tmp_path))
    points, sides = samples.arm_points()
    np.testing.assert_allclose(by_position(mesh), np.unique(points * METRE, axis=0), atol=1e-8)
    assert len(mesh.faces) == 2 * len(sides)
    assert mesh.up == "+y"
    assert [part.name for part in mesh.parts] == ["skin"]
    # Missing normals are computed, and they point outwards.
    normals, centres = mesh.corner_normals, mesh.vertices[mesh.faces] * [1, 0, 1]
    assert (np.einsum("fkc,fkc->fk", normals, centres) > 0).all()


@pytest.mark.parametrize(
    ("file", "unit", "turned"),
    [
        (samples.FbxFile(unit=2.54), 0.0254, lambda p: p),
        (samples.FbxFile(unit=100.0), 1.0, lambda p: p),
        (samples.FbxFile(up=2), 0.01, lambda p: np.stack([p[:, 0], p[:, 2], -p[:, 1]], axis=1)),
    ],
)
def test_axes_and_units_become_y_up_and_metres(file, unit, turned, tmp_path):
    path = at(tmp_path, file)
    mesh = load_mesh(path)
    expected = turned(samples.arm_points()[0]) * unit
    np.testing.assert_allclose(by_position(mesh), np.unique(expected.round(9), axis=0), atol=1e-7)
    rig = read_skin(path)
    np.testing.assert_allclose(rig.joints, turned(np.array([[0.0, 0, 0], [0, samples.UPPER, 0]])) * unit, atol=1e-8)
    details = dict(mesh.source.details)
    assert details["unit"] == f"metre, y up (converted from {unit:g} m, {'+z' if file.up == 2 else '+y'} up)"


def test_scale_of_blender_and_its_centimetres_cancel(tmp_path):
    """Blender writes metres as centimetres below a scale of 100 on each object; no scale remains."""
    file = samples.FbxFile()
    samples.geometry(file, 100, *samples.arm_points())
    file.model(200, "object", "Mesh", 0, samples.scaling([100, 100, 100]))
    file.link(100, 200)
    document = open_document(file.save(tmp_path / "a.fbx"))
    assert "scale" not in document.gltf["nodes"][0]
    np.testing.assert_allclose(np.ptp(load_mesh(tmp_path / "a.fbx").vertices, axis=0), [0.5, 4, 0.5], atol=1e-7)


def test_skin_has_all_influences_and_the_bind_pose(tmp_path):
    path = at(tmp_path)
    rig = read_skin(path)
    assert rig.joint_names == ("Upper", "Lower")
    assert rig.parents == (-1, 0)
    assert [node.get("name") for node in open_document(path).gltf["nodes"]] == ["skin", "armature", "Upper", "Lower"]
    dense = np.zeros((len(rig.weights), 2))
    np.add.at(dense, (np.arange(len(dense))[:, None], rig.joint_of), rig.weights)
    level = np.round(rig.mesh.vertices[:, 1] / METRE)
    expected = {0: [1, 0], samples.UPPER: [0.5, 0.5], samples.UPPER + samples.LOWER: [0, 1]}
    np.testing.assert_allclose(dense, [expected[int(height)] for height in level], atol=1e-7)


def test_more_than_four_influences_are_kept(tmp_path):
    file = samples.FbxFile()
    points, sides = samples.arm_points()
    samples.geometry(file, 100, points, sides)
    file.model(200, "skin", "Mesh", 0)
    file.link(100, 200)
    file.add("Deformer", 300, "Deformer::skin", "Skin", "Version: 101")
    file.link(300, 100)
    everything = np.arange(len(points))
    for k in range(6):
        bone = file.model(400 + k, f"bone {k}", "LimbNode", 0, samples.translation([k, 0, 0]))
        bind = np.eye(4)
        bind[0, 3] = k
        body = f"Indexes: {samples.numbers(everything)}\nWeights: {samples.numbers((everything + 1) * (k + 1))}\n"
        body += f"Transform: {samples.numbers(np.linalg.inv(bind).T)}\nTransformLink: {samples.numbers(bind.T)}"
        file.add("Deformer", 500 + k, "SubDeformer::bone", "Cluster", body)
        file.link(500 + k, 300)
        file.link(bone, 500 + k)
    rig = read_skin(file.save(tmp_path / "a.fbx"))
    assert rig.weights.shape[1] == 8
    np.testing.assert_allclose(
        np.sort(rig.weights, axis=1)[:, 2:], np.arange(1, 7) / 21 + 0 * rig.weights[:, :1], atol=1e-6
    )
    np.testing.assert_allclose((rig.weights[..., None] * rig.points).sum(axis=1), rig.mesh.vertices, atol=1e-8)


def test_vertices_without_a_bone_stay_with_their_mesh(tmp_path):
    file = samples.arm()
    # Of the upper bone only the first points are left; the ring in the middle keeps half a weight.
    file.objects = [
        entry.replace(samples.numbers(np.ones(4).tolist() + [0.5] * 4), samples.numbers([0.0] * 8))
        for entry in file.objects
    ]
    mesh = load_mesh(file.save(tmp_path / "a.fbx"))
    np.testing.assert_allclose(by_position(mesh), np.unique(samples.arm_points()[0] * METRE, axis=0), atol=1e-8)


def test_file_pose_that_is_not_the_bind_pose_is_read_as_posed(tmp_path):
    file = samples.arm()
    file.objects = [
        entry.replace(
            samples.translation([0, samples.UPPER, 0]),
            samples.translation([0, samples.UPPER, 0]) + "\n" + samples.rotation([0, 0, 90]),
        )
        for entry in file.objects
    ]
    path = file.save(tmp_path / "a.fbx")
    mesh, document = load_mesh(path), open_document(path)
    tip = mesh.vertices[mesh.vertices[:, 0] < -1.5 * METRE]
    np.testing.assert_allclose(tip.mean(axis=0), [-3 * METRE, METRE, 0], atol=1e-8)
    stored = read_floats(document, document.gltf["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    np.testing.assert_allclose(
        np.unique(stored.round(6), axis=0), np.unique((samples.arm_points()[0] * METRE).round(6), axis=0), atol=1e-7
    )


def animated_arm(path, fps=6, seconds=1.0):
    """Write an arm whose lower bone turns by 90 degrees about z in a second, linearly."""
    file = samples.arm(samples.FbxFile(fps=fps))
    layer = samples.stack(file, 600, "Bend", seconds)
    samples.curve(file, 610, layer, 203, "Lcl Rotation", "d|Z", [0, seconds], [0, 90])
    still = samples.stack(file, 700, "Nothing", seconds)
    samples.curve(file, 710, still, 203, "Lcl Rotation", "d|Z", [0, seconds], [0, 0])
    return file.save(path / "arm.fbx")


@pytest.mark.parametrize(("fps", "rate"), [(6, 30), (11, 24)])
def test_animation_is_sampled_at_the_rate_of_the_file(fps, rate, tmp_path):
    path = animated_arm(tmp_path, fps)
    document = open_document(path)
    assert animation_names(document) == ("Bend",)  # one that changes nothing is left out
    (channel,) = read_channels(document, 0)
    assert (document.gltf["nodes"][channel.node]["name"], channel.path) == ("Lower", "rotation")
    np.testing.assert_allclose(channel.times, np.arange(rate + 1) / rate, atol=1e-7)
    half = np.radians(90 * channel.times) / 2
    np.testing.assert_allclose(channel.values, np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], 1), atol=1e-6)
    clip = load_clip(path)
    assert (len(clip), clip.fps) == (rate + 1, rate)
    top = np.isclose(clip.vertices[0][:, 1], 4 * METRE)
    np.testing.assert_allclose(clip.vertices[-1][top].mean(axis=0), [-3 * METRE, METRE, 0], atol=1e-7)


def test_constant_channel_off_rest_has_one_key(tmp_path):
    file = samples.arm()
    layer = samples.stack(file, 600, "Pose", 0.5)
    samples.curve(file, 610, layer, 202, "Lcl Translation", "d|X", [0, 0.5], [7, 7])
    (channel,) = read_channels(open_document(file.save(tmp_path / "a.fbx")), 0)
    assert (channel.path, channel.times.tolist()) == ("translation", [0.0])
    np.testing.assert_allclose(channel.values, [[7 * METRE, 0, 0]], atol=1e-8)


def test_blend_shapes_have_names_and_animated_weights(tmp_path):
    file = samples.arm()
    channel = samples.blend_shape(file, 800, "smile", {8: [0, 0, 2], 9: [0, 0, 2]})
    layer = samples.stack(file, 600, "Talk", 1.0)
    samples.curve(file, 610, layer, channel, "DeformPercent", "d|DeformPercent", [0, 1], [0, 100])
    path = file.save(tmp_path / "a.fbx")
    document = open_document(path)
    assert document.gltf["meshes"][0]["extras"] == {"targetNames": ["smile"]}
    clip = load_clip(path)
    moved = clip.vertices[-1] - clip.vertices[0]
    assert set(np.abs(moved).max(axis=1).round(6).tolist()) == {0.0, 2 * METRE}
    np.testing.assert_allclose(clip.vertices[15] - clip.vertices[0], moved / 2, atol=1e-7)


LAYERS = """
LayerElementUV: 0 {
 Version: 101
 Name: "map"
 MappingInformationType: "ByVertice"
 ReferenceInformationType: "Direct"
 UV: %s
}
LayerElementColor: 0 {
 Version: 101
 Name: "paint"
 MappingInformationType: "ByVertice"
 ReferenceInformationType: "Direct"
 Colors: %s
}
LayerElementMaterial: 0 {
 Version: 101
 MappingInformationType: "ByPolygon"
 ReferenceInformationType: "IndexToDirect"
 Materials: %s
}
"""


def looks(tmp_path, texture_name="skin.png"):
    """Write an arm with UVs, colours and two materials, the second with a texture."""
    points = samples.arm_points()[0]
    uv, colors = points[:, :2], np.tile([0.25, 0.5, 0.75, 1.0], (len(points), 1))
    extra = LAYERS % (samples.numbers(uv), samples.numbers(colors), samples.numbers([0] * 4 + [1] * 4))
    file = samples.arm(extra=extra)
    samples.material(file, 900, "red", [1, 0, 0])
    samples.texture(file, 902, texture_name, samples.material(file, 901, "painted", [0, 0, 0]))
    return file.save(tmp_path / "arm.fbx")


def picture(path, kind):
    with io.BytesIO() as file:
        Image.new("RGB", (2, 2), (10, 20, 30)).save(file, kind)
        path.write_bytes(file.getvalue())


def test_materials_uvs_and_colours(tmp_path):
    picture(tmp_path / "skin.png", "PNG")
    mesh = load_mesh(looks(tmp_path))
    assert [part.material.name for part in mesh.parts] == ["red", "painted"]
    assert mesh.parts[0].material.base_color == (1, 0, 0, 1)
    # A texture replaces the colour; it is found beside the file although its path is another machine's.
    assert mesh.parts[1].material.base_color == (1, 1, 1, 1)
    assert mesh.parts[1].material.texture == (tmp_path / "skin.png").read_bytes()
    np.testing.assert_allclose(mesh.vertex_colors, np.tile([0.25, 0.5, 0.75, 1], (len(mesh.vertices), 1)), atol=1e-6)
    np.testing.assert_allclose(mesh.corner_uv, mesh.vertices[mesh.faces][..., :2] / METRE, atol=1e-6)


def test_texture_in_another_format_becomes_png(tmp_path):
    picture(tmp_path / "skin.tga", "TGA")
    texture = load_mesh(looks(tmp_path, "skin.tga")).parts[1].material.texture
    assert np.array(Image.open(io.BytesIO(texture))).tolist() == [[[10, 20, 30]] * 2] * 2


def test_missing_texture_is_noted_and_not_written(tmp_path):
    mesh = load_mesh(looks(tmp_path))
    assert mesh.parts[1].material.texture is None
    assert mesh.source.missing_images == ("skin.png",)
    save_mesh(mesh, tmp_path / "b.glb")
    assert "textures" not in open_document(tmp_path / "b.glb").gltf


def test_a_texture_that_names_no_file_is_not_missing(tmp_path):
    """Exporters write textures whose image was never set."""
    assert load_mesh(looks(tmp_path, "")).source.missing_images == ()


def test_textures_outside_of_a_confining_folder_are_not_read(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "lost").mkdir()
    picture(tmp_path / "lost" / "skin.png", "PNG")
    path = looks(inner)
    assert load_mesh(path).parts[1].material.texture is not None
    with confined(inner):
        assert load_mesh(path).parts[1].material.texture is None


def test_fbx_is_written_as_glb(tmp_path):
    mesh = load_mesh(animated_arm(tmp_path))
    save_mesh(mesh, tmp_path / "b.glb")
    np.testing.assert_allclose(load_mesh(tmp_path / "b.glb").vertices, mesh.vertices, atol=1e-9)
    clip = load_clip(tmp_path / "arm.fbx")
    save_clip(clip, tmp_path / "c.glb")
    np.testing.assert_allclose(load_clip(tmp_path / "c.glb").vertices, clip.vertices, atol=1e-8)


def test_hidden_meshes_are_left_out(tmp_path):
    file = samples.arm()
    samples.geometry(file, 101, samples.arm_points()[0] + 50, samples.arm_points()[1])
    file.model(250, "hidden", "Mesh", 0, 'P: "Visibility", "Visibility", "", "A",0')
    file.link(101, 250)
    assert load_mesh(file.save(tmp_path / "a.fbx")).vertices.max() < 5 * METRE


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"FBX", "expected an FBX file, found"),
        (b"Kaydara FBX Binary  \x00\x1a\x00" + bytes(40), "expected"),
        (b"o cube\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "expected"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "expected an FBX file, found"),
    ],
)
def test_other_contents_are_refused_in_one_line(content, found, tmp_path):
    (tmp_path / "a.fbx").write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_mesh(tmp_path / "a.fbx")
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'a.fbx'}: ")
    assert found in message
    assert "\n" not in message


def test_numbers_beyond_single_precision_are_refused_by_name(tmp_path):
    path = samples.arm(root=samples.translation([1e60, 0, 0])).save(tmp_path / "a.fbx")
    path.write_text(path.read_text().replace(" a: 0.25,", " a: 1e300,", 1))
    with pytest.raises(InputError, match=r"expected finite numbers up to 3.4e38, found others") as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_skeleton_without_a_mesh_is_a_motion(tmp_path):
    """Joints named as a person's play on the shipped body."""
    file = samples.FbxFile()
    bones = {"Hips": (0, [0, 100, 0]), "Spine": (1, [0, 20, 0]), "Neck": (2, [0, 30, 0]), "Head": (3, [0, 10, 0])}
    for side, x in (("Left", 1), ("Right", -1)):
        bones |= {f"{side}UpLeg": (1, [10 * x, -5, 0]), f"{side}Leg": (f"{side}UpLeg", [0, -45, 0])}
        bones |= {f"{side}Foot": (f"{side}Leg", [0, -45, 0]), f"{side}Arm": (2, [18 * x, 25, 0])}
        bones |= {f"{side}ForeArm": (f"{side}Arm", [28 * x, 0, 0]), f"{side}Hand": (f"{side}ForeArm", [25 * x, 0, 0])}
    names = list(bones)
    for number, (name, (parent, place)) in enumerate(bones.items(), 1):
        above = names.index(parent) + 1 if isinstance(parent, str) else parent
        file.model(number, f"mixamorig:{name}", "LimbNode", above, samples.translation(place))
        file.add("NodeAttribute", 1000 + number, "NodeAttribute::", "LimbNode", 'TypeFlags: "Skeleton"')
        file.link(1000 + number, number)
    layer = samples.stack(file, 600, "Wave", 1.0)
    samples.curve(file, 610, layer, names.index("LeftArm") + 1, "Lcl Rotation", "d|Z", [0, 1], [0, 60])
    clip = load_clip(file.save(tmp_path / "wave.fbx"))
    assert len(clip) == 31
    assert np.abs(clip.vertices[-1] - clip.vertices[0]).max() > 0.3
