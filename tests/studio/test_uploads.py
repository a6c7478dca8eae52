"""What an upload names is read from its own folder alone; what the command line names may lie anywhere."""

import io
import json
import zipfile

import numpy as np
import pytest
import zoo
from PIL import Image

from mimesh import InputError, load_mesh, save_mesh
from mimesh.io.beside import confined, is_there
from mimesh.studio.operations import read_clip, read_mesh

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n"
MATERIAL = "newmtl a\nKd 0.5 0.25 0.125\nmap_Kd {}\n"


@pytest.fixture
def places(tmp_path):
    """The folder of an upload, and one beside it with what is nobody's business."""
    ours, secret = tmp_path / "upload", tmp_path / "secret"
    for folder in (ours, secret):
        folder.mkdir()
    picture = io.BytesIO()
    Image.new("RGB", (4, 4), (200, 40, 30)).save(picture, "PNG")
    (secret / "face.png").write_bytes(picture.getvalue())
    (secret / "looks.mtl").write_text(MATERIAL.format("face.png"))
    return ours, secret


def ways(folder, secret, name):
    """The ways in which a file in `folder` may name one outside."""
    (folder / "x").mkdir(exist_ok=True)
    (folder / "link").unlink(missing_ok=True)
    (folder / "link").symlink_to(secret / name)
    return [f"../secret/{name}", str(secret / name), f"x/../../secret/{name}", "link"]


def only_confined(path, folder, looks):
    """Something of a mesh is had when it is the user's own, and not when it is an upload."""
    assert looks(load_mesh(path)), "or this test shows nothing"
    assert not looks(read_mesh(path, folder))
    assert looks(read_mesh(path, None))


def texture(mesh):
    return [part.material.texture for part in mesh.parts if part.material and part.material.texture]


def test_images_of_a_gltf(places):
    ours, secret = places
    for name in ways(ours, secret, "face.png"):
        path = ours / "a.gltf"
        save_mesh(zoo.cube(), path)
        document = json.loads(path.read_text())
        document["images"] = [{"uri": name}]
        document["textures"] = [{"source": 0}]
        document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        document["meshes"][0]["primitives"][0]["material"] = 0
        path.write_text(json.dumps(document))
        only_confined(path, ours, texture)


def test_buffers_of_a_gltf(places):
    ours, secret = places
    (secret / "passwords").write_bytes(np.square(np.arange(9, dtype="<f4")).tobytes())
    for name in ways(ours, secret, "passwords"):
        document = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 36, "uri": name}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
        (ours / "a.gltf").write_text(json.dumps(document))
        assert load_mesh(ours / "a.gltf").vertices[2, 2] == 64
        with pytest.raises(InputError, match="found no file"):
            read_mesh(ours / "a.gltf", ours)
        with pytest.raises(InputError, match="found no file"):
            read_clip(ours / "a.gltf", ours, "a", None, None)


def test_libraries_and_images_of_an_obj(places):
    ours, secret = places
    for name in ways(ours, secret, "looks.mtl"):
        (ours / "a.obj").write_text(f"mtllib {name}\n{TRIANGLE}")
        # What a library names by itself is looked for beside it.
        only_confined(ours / "a.obj", ours, lambda mesh: mesh.parts[0].material.base_color[0] == 0.5)
    for name in ways(ours, secret, "face.png"):
        (ours / "a.mtl").write_text(MATERIAL.format(name))
        (ours / "a.obj").write_text(f"mtllib a.mtl\n{TRIANGLE}")
        only_confined(ours / "a.obj", ours, texture)


HEAD = "#usda 1.0\n"
MESH = """def Mesh "{name}" {{
  point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
  int[] faceVertexCounts = [3]
  int[] faceVertexIndices = [0, 1, 2]
}}
"""
OWN = MESH.format(name="own")
NAMING = {
    "reference": OWN + 'def "other" (references = @{}@</other>) {{\n}}\n',
    "payload": OWN + 'def "other" (payload = @{}@</other>) {{\n}}\n',
    "sublayer": "(\n subLayers = [@{}@]\n)\n" + OWN,
    "asset": OWN + 'def "other" {{\n asset file = @{}@\n}}\n',
    "variant": OWN + 'def "v" (\n variants = {{ string a = "b" }}\n prepend variantSets = "a"\n) {{\n'
    ' variantSet "a" = {{\n "b" (references = @{}@</other>) {{\n }}\n }}\n}}\n',
}


@pytest.mark.parametrize("text", NAMING.values(), ids=NAMING)
def test_layers_and_assets_of_usd(places, text):
    pytest.importorskip("pxr")
    ours, secret = places
    (secret / "other.usda").write_text(HEAD + MESH.format(name="other"))
    (ours / "between.usda").write_text(HEAD)
    for name in ways(ours, secret, "other.usda")[:3]:
        text_of_mesh = text.replace(OWN, MESH.replace("{name}", "own")).format(name)
        path, between, package = ours / "a.usda", ours / "b.usda", ours / "c.usdz"
        path.write_text(HEAD + text_of_mesh)
        between.write_text(HEAD + "(\n subLayers = [@a.usda@]\n)\n")
        with zipfile.ZipFile(package, "w") as pack:
            pack.writestr("a.usda", path.read_text())
        for file in (path, between, package):
            if file == package and not name.startswith("/"):
                continue  # such a name stays in the package
            assert len(load_mesh(file).vertices) in (3, 6)
            with pytest.raises(InputError, match="came with it"):
                read_mesh(file, ours)


def test_what_came_along_is_read(places):
    ours, secret = places
    (ours / "in").mkdir()
    (ours / "face.png").write_bytes((secret / "face.png").read_bytes())
    (ours / "in" / "a.mtl").write_text(MATERIAL.format("../face.png"))
    (ours / "in" / "a.obj").write_text(f"mtllib a.mtl\n{TRIANGLE}")
    assert texture(read_mesh(ours / "in" / "a.obj", ours))
    pytest.importorskip("pxr")
    (ours / "other.usda").write_text(HEAD + MESH.format(name="other"))
    (ours / "in" / "a.usda").write_text(HEAD + "(\n subLayers = [@../other.usda@, @../../gone.usda@]\n)\n")
    assert len(read_mesh(ours / "in" / "a.usda", ours).vertices) == 3


def test_a_package_is_not_unpacked_beyond_its_size(tmp_path):
    pytest.importorskip("pxr")
    from mimesh.io.usd.package import unpack

    with zipfile.ZipFile(tmp_path / "bomb.usdz", "w", zipfile.ZIP_DEFLATED) as pack:
        pack.writestr("a.usda", bytes(2**20))
    with pytest.raises(InputError, match="compressed"):
        unpack(tmp_path / "bomb.usdz", tmp_path / "out")


def test_a_few_letters_do_not_take_all_memory(tmp_path):
    document = {
        "asset": {"version": "2.0"},
        "accessors": [{"componentType": 5126, "count": 2 * 10**9, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(InputError, match="without any"):
        load_mesh(tmp_path / "a.gltf")


def test_the_end_of_a_context_is_the_end_of_its_rule(places):
    ours, secret = places
    with confined(ours):
        assert not is_there(secret / "face.png")
        assert not is_there("\0")
    assert is_there(secret / "face.png")
