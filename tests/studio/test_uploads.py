"""Files that an uploaded mesh refers to are read from its own folder only; those of local meshes from anywhere."""

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
def folders(tmp_path):
    """The folder of an upload, and one beside it that uploads must not read."""
    upload, secret = tmp_path / "upload", tmp_path / "secret"
    for folder in (upload, secret):
        folder.mkdir()
    picture = io.BytesIO()
    Image.new("RGB", (4, 4), (200, 40, 30)).save(picture, "PNG")
    (secret / "face.png").write_bytes(picture.getvalue())
    (secret / "looks.mtl").write_text(MATERIAL.format("face.png"))
    return upload, secret


def references(folder, secret, name):
    """List the ways to refer from a file in `folder` to one outside."""
    (folder / "x").mkdir(exist_ok=True)
    (folder / "link").unlink(missing_ok=True)
    (folder / "link").symlink_to(secret / name)
    return [f"../secret/{name}", str(secret / name), f"x/../../secret/{name}", "link"]


def only_confined(path, folder, detect):
    """Check that `detect` finds something in a local mesh, and not in the same mesh as an upload."""
    assert detect(load_mesh(path)), "else this test shows nothing"
    assert not detect(read_mesh(path, folder))
    assert detect(read_mesh(path, None))


def texture(mesh):
    return [part.material.texture for part in mesh.parts if part.material and part.material.texture]


def test_images_of_gltf_are_confined(folders):
    upload, secret = folders
    for name in references(upload, secret, "face.png"):
        path = upload / "a.gltf"
        save_mesh(zoo.cube(), path)
        document = json.loads(path.read_text())
        document["images"] = [{"uri": name}]
        document["textures"] = [{"source": 0}]
        document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        document["meshes"][0]["primitives"][0]["material"] = 0
        path.write_text(json.dumps(document))
        only_confined(path, upload, texture)


def test_buffers_of_gltf_are_confined(folders):
    upload, secret = folders
    (secret / "passwords").write_bytes(np.square(np.arange(9, dtype="<f4")).tobytes())
    for name in references(upload, secret, "passwords"):
        document = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 36, "uri": name}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
        (upload / "a.gltf").write_text(json.dumps(document))
        assert load_mesh(upload / "a.gltf").vertices[2, 2] == 64
        with pytest.raises(InputError, match="found no file"):
            read_mesh(upload / "a.gltf", upload)
        with pytest.raises(InputError, match="found no file"):
            read_clip(upload / "a.gltf", upload, "a", None, None)


def test_libraries_and_images_of_obj_are_confined(folders):
    upload, secret = folders
    for name in references(upload, secret, "looks.mtl"):
        (upload / "a.obj").write_text(f"mtllib {name}\n{TRIANGLE}")
        # Images that a library refers to are searched beside it.
        only_confined(upload / "a.obj", upload, lambda mesh: mesh.parts[0].material.base_color[0] == 0.5)
    for name in references(upload, secret, "face.png"):
        (upload / "a.mtl").write_text(MATERIAL.format(name))
        (upload / "a.obj").write_text(f"mtllib a.mtl\n{TRIANGLE}")
        only_confined(upload / "a.obj", upload, texture)


HEAD = "#usda 1.0\n"
MESH = """def Mesh "{name}" {{
  point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
  int[] faceVertexCounts = [3]
  int[] faceVertexIndices = [0, 1, 2]
}}
"""
FIRST = MESH.format(name="first")
NAMING = {
    "reference": FIRST + 'def "other" (references = @{}@</other>) {{\n}}\n',
    "payload": FIRST + 'def "other" (payload = @{}@</other>) {{\n}}\n',
    "sublayer": "(\n subLayers = [@{}@]\n)\n" + FIRST,
    "asset": FIRST + 'def "other" {{\n asset file = @{}@\n}}\n',
    "variant": FIRST + 'def "v" (\n variants = {{ string a = "b" }}\n prepend variantSets = "a"\n) {{\n'
    ' variantSet "a" = {{\n "b" (references = @{}@</other>) {{\n }}\n }}\n}}\n',
}


@pytest.mark.parametrize("text", NAMING.values(), ids=NAMING)
@pytest.mark.usefixtures("in_process")
def test_layers_and_assets_of_usd_are_confined(folders, text):
    pytest.importorskip("pxr")
    upload, secret = folders
    (secret / "other.usda").write_text(HEAD + MESH.format(name="other"))
    (upload / "between.usda").write_text(HEAD)
    for name in references(upload, secret, "other.usda")[:3]:
        text_of_mesh = text.replace(FIRST, MESH.replace("{name}", "first")).format(name)
        path, between, package = upload / "a.usda", upload / "b.usda", upload / "c.usdz"
        path.write_text(HEAD + text_of_mesh)
        between.write_text(HEAD + "(\n subLayers = [@a.usda@]\n)\n")
        with zipfile.ZipFile(package, "w") as pack:
            pack.writestr("a.usda", path.read_text())
        for file in (path, between, package):
            if file == package and not name.startswith("/"):
                continue  # such a name stays in the package
            assert len(load_mesh(file).vertices) in (3, 6)
            with pytest.raises(InputError, match="came with it"):
                read_mesh(file, upload)


@pytest.mark.slow
def test_files_of_the_same_upload_are_read(folders):
    upload, secret = folders
    (upload / "in").mkdir()
    (upload / "face.png").write_bytes((secret / "face.png").read_bytes())
    (upload / "in" / "a.mtl").write_text(MATERIAL.format("../face.png"))
    (upload / "in" / "a.obj").write_text(f"mtllib a.mtl\n{TRIANGLE}")
    assert texture(read_mesh(upload / "in" / "a.obj", upload))
    pytest.importorskip("pxr")
    (upload / "other.usda").write_text(HEAD + MESH.format(name="other"))
    (upload / "in" / "a.usda").write_text(HEAD + "(\n subLayers = [@../other.usda@, @../../gone.usda@]\n)\n")
    assert len(read_mesh(upload / "in" / "a.usda", upload).vertices) == 3


def test_compressed_usd_packages_are_refused(tmp_path):
    pytest.importorskip("pxr")
    from mimesh.io.usd.read import check_package

    with zipfile.ZipFile(tmp_path / "bomb.usdz", "w", zipfile.ZIP_DEFLATED) as pack:
        pack.writestr("a.usda", bytes(2**20))
    with pytest.raises(InputError, match="compressed"):
        check_package(tmp_path / "bomb.usdz")


def test_confinement_ends_with_its_context(folders):
    upload, secret = folders
    with confined(upload):
        assert not is_there(secret / "face.png")
        assert not is_there("\0")
    assert is_there(secret / "face.png")
