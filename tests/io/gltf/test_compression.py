"""Draco and meshopt compressed files read as the plain ones they were made of."""

import importlib.util

import gltf_samples as samples
import numpy as np
import pytest
from compressed_files import DRACO, MESHOPT, draco_glb, meshopt_glb, require
from gltf_reference import binary_of, json_of
from gltf_samples import pack_glb
from rigs import character, read_skin

from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh, save_mesh
from mimesh.io.gltf.check import list_primitives
from mimesh.io.gltf.document import open_document, read_accessor
from mimesh.io.gltf.draft import AccessorCopier

pytestmark = pytest.mark.usefixtures("in_process")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A file with a skin, morph targets, an animation, strides, sparse accessors, strips, points and images."""
    return samples.hero().glb(tmp_path_factory.mktemp("plain") / "plain.glb")


@pytest.fixture(scope="module")
def by_meshopt(plain):
    return meshopt_glb(plain, plain.with_name("meshopt.glb"))


@pytest.fixture(scope="module")
def by_draco(plain):
    return draco_glb(plain, plain.with_name("draco.glb"))


@pytest.fixture(params=["meshopt", "draco"])
def compressed(request):
    return request.getfixturevalue(f"by_{request.param}")


@pytest.mark.parametrize(("name", "version"), [(MESHOPT, 0), ("KHR_meshopt_compression", 1)])
def test_meshopt_is_decoded_exactly(name, version, plain, tmp_path):
    path = meshopt_glb(plain, tmp_path / "small.glb", name, version)
    expected, mesh = load_mesh(plain), load_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, expected.vertices)
    # The codec may turn the corners of a triangle, not its winding.
    turned = [
        np.take_along_axis(f, (np.argmin(f, 1)[:, None] + np.arange(3)) % 3, 1) for f in (mesh.faces, expected.faces)
    ]
    np.testing.assert_array_equal(*turned)
    np.testing.assert_array_equal(load_clip(path).vertices, load_clip(plain).vertices)
    rig, expected_rig = read_skin(path), read_skin(plain)
    np.testing.assert_array_equal(rig.weights, expected_rig.weights)
    np.testing.assert_array_equal(rig.joint_of, expected_rig.joint_of)
    assert [part.material for part in mesh.parts] == [part.material for part in expected.parts]


def test_meshopt_filters_are_undone(tmp_path):
    meshopt = pytest.importorskip("meshopt")
    points = np.random.default_rng(0).normal(size=(32, 3)).astype(np.float32)
    rows = meshopt.encode_filter_exp(points, 15)
    blob = meshopt.encode_gltf_buffer(rows, "ATTRIBUTES")
    extension = {"buffer": 0, "byteLength": len(blob), "byteStride": 12, "count": 32, "mode": "ATTRIBUTES"}
    view = {"buffer": 1, "byteLength": 384, "byteStride": 12}
    gltf = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(blob)}, {"byteLength": 384, "extensions": {MESHOPT: {"fallback": True}}}],
        "bufferViews": [{**view, "extensions": {MESHOPT: {**extension, "filter": "EXPONENTIAL"}}}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 32, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 4}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    require(gltf, MESHOPT)
    (tmp_path / "a.glb").write_bytes(pack_glb(gltf, blob))
    mesh = load_mesh(tmp_path / "a.glb")
    np.testing.assert_allclose(mesh.vertices, points, atol=np.abs(points).max() / 2**13)


def at_corners(mesh, values):
    """Return values of vertices at the corners of the faces: Draco gives each primitive vertices of its own."""
    return np.asarray(values)[..., mesh.faces, :]


def test_draco_is_decoded_within_its_quantization(plain, by_draco):
    path = by_draco
    expected, mesh = load_mesh(plain), load_mesh(path)
    step = 2 * np.ptp(expected.vertices, axis=0).max() / 2**16
    np.testing.assert_allclose(at_corners(mesh, mesh.vertices), at_corners(expected, expected.vertices), atol=step)
    frames, expected_frames = load_clip(path).vertices, load_clip(plain).vertices
    np.testing.assert_allclose(at_corners(mesh, frames), at_corners(expected, expected_frames), atol=step)
    rig, expected_rig = read_skin(path), read_skin(plain)
    for name in ("joint_of", "weights"):
        values, expected_values = getattr(rig, name), getattr(expected_rig, name)
        np.testing.assert_array_equal(at_corners(mesh, values), at_corners(expected, expected_values))
    np.testing.assert_array_equal(mesh.corner_uv, expected.corner_uv)
    small, whole = open_document(path), open_document(plain)
    for primitive, old in zip(list_primitives(small.gltf), list_primitives(whole.gltf), strict=True):
        if "WEIGHTS_0" in old["attributes"]:  # weights that add up keep their bytes
            stored = read_accessor(small, primitive["attributes"]["WEIGHTS_0"])
            np.testing.assert_array_equal(stored, read_accessor(whole, old["attributes"]["WEIGHTS_0"]))


def test_weights_and_bounds_that_draco_changed_are_corrected(tmp_path):
    """Quantized weights add up to 0.999, and quantized positions leave the bounds that the JSON states."""
    plain = character(tmp_path / "plain.glb")
    content = bytearray(plain.read_bytes())
    document = open_document(plain)
    attributes = list_primitives(document.gltf)[0]["attributes"]
    sets = [read_accessor(document, attributes[name]) for name in ("WEIGHTS_0", "WEIGHTS_1")]
    for weights in sets:
        start = content.index(weights.tobytes())
        content[start : start + weights.nbytes] = (weights * np.float32(0.999)).tobytes()
    plain.write_bytes(content)

    def with_other_bounds(gltf):
        for accessor in gltf["accessors"]:
            accessor |= {key: [0.0] * len(accessor[key]) for key in ("min", "max") if key in accessor}

    small = open_document(altered(draco_glb(plain, tmp_path / "draco.glb"), with_other_bounds, tmp_path))
    attributes = list_primitives(small.gltf)[0]["attributes"]
    found = [read_accessor(small, attributes[name]) for name in ("WEIGHTS_0", "WEIGHTS_1")]
    total = sum(weights.sum(axis=1, dtype=float) for weights in found)
    assert np.abs(total - 1).max() < 2e-7
    np.testing.assert_allclose(found, sets, atol=1e-6)
    accessor, points = small.gltf["accessors"][attributes["POSITION"]], read_accessor(small, attributes["POSITION"])
    assert (accessor["min"], accessor["max"]) == (points.min(axis=0).tolist(), points.max(axis=0).tolist())


def test_compressed_file_is_written_plain(compressed, tmp_path):
    mesh = load_mesh(compressed)
    save_mesh(mesh, tmp_path / "again.glb")
    again = open_document(tmp_path / "again.glb").gltf
    assert not {DRACO, MESHOPT} & {*again.get("extensionsUsed", []), *again.get("extensionsRequired", [])}
    np.testing.assert_allclose(load_mesh(tmp_path / "again.glb").vertices, mesh.vertices, atol=1e-5)
    # Compressed bytes are dropped, and views keep their numbers.
    gltf, document = json_of(compressed), open_document(compressed)
    views = document.gltf["bufferViews"]
    assert len(views) >= len(gltf["bufferViews"])
    dead = {p["extensions"][DRACO]["bufferView"] for p in list_primitives(gltf) if "extensions" in p}
    assert all(views[k]["byteLength"] == 1 for k in dead)
    used = sum(view["byteLength"] + 4 for k, view in enumerate(views) if k not in dead)
    assert len(document.binary) <= used
    AccessorCopier(document, whole=True).draft.save(tmp_path / "again.glb")
    again = open_document(tmp_path / "again.glb")
    for index in range(len(again.gltf["accessors"])):
        np.testing.assert_array_equal(read_accessor(again, index), read_accessor(document, index))


def test_compressed_copies_of_plain_data_are_dropped(by_meshopt, tmp_path):
    expected = open_document(by_meshopt)

    def optional(gltf):
        """Give the views their data in the first buffer too."""
        gltf["extensionsRequired"] = []
        gltf["buffers"] = gltf["buffers"][:1]
        for view, whole in zip(gltf["bufferViews"], expected.gltf["bufferViews"], strict=True):
            view |= {"buffer": 0, "byteOffset": gltf["buffers"][0]["byteLength"] + whole["byteOffset"]}
        gltf["buffers"][0]["byteLength"] += len(expected.binary)

    document = open_document(altered(by_meshopt, optional, tmp_path, bytes(expected.binary)))
    assert len(document.binary) == len(expected.binary)
    for index in range(len(document.gltf["accessors"])):
        np.testing.assert_array_equal(read_accessor(document, index), read_accessor(expected, index))


def test_missing_decoder_names_the_extra(compressed, monkeypatch):
    find, package = importlib.util.find_spec, {"meshopt": "meshopt", "draco": "DracoPy"}[compressed.stem]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == package else find(name, *rest))
    with pytest.raises(InputError, match=rf"expected {package} to read .*pip install 'mimesh\[compressed\]'"):
        load_mesh(compressed)


def altered(path, change, folder, more=b""):
    """Write a .glb with another JSON, and more bytes at its end, into a folder."""
    gltf = json_of(path)
    change(gltf)
    target = folder / "altered.glb"
    target.write_bytes(pack_glb(gltf, binary_of(path) + more))
    return target


def every_view(**changes):
    def change(gltf):
        for view in gltf["bufferViews"]:
            for extension in view.get("extensions", {}).values():
                extension.update(changes)

    return change


def with_extensions_inside(gltf):
    every_view(extensions=1)(gltf)
    every_view(count=10**9)(gltf)


def without_extension(gltf):
    del gltf["bufferViews"][0]["extensions"]


MESHOPT_FAULTS = {
    "count": (every_view(count=10**9), "bytes of ATTRIBUTES"),
    "stride": (every_view(byteStride=3), "bytes of ATTRIBUTES"),
    "mode": (every_view(mode="SECRET"), "bytes of ATTRIBUTES"),
    "filter": (every_view(filter="SECRET"), "bytes of ATTRIBUTES"),
    "range": (every_view(byteLength=10**9), "inside its buffer"),
    "buffer": (every_view(buffer=7), "to be one of 2 buffers, found 7"),
    "negative": (every_view(byteOffset=-4), "a count in"),
    "extensions inside": (with_extensions_inside, "bytes of ATTRIBUTES"),
    "no data": (without_extension, "compressed data in buffer view 0, found none"),
    "data": (every_view(byteOffset=4), "expected a file that can be read, found"),
}


@pytest.mark.parametrize("fault", MESHOPT_FAULTS)
def test_contradictory_meshopt_is_refused(fault, by_meshopt, tmp_path):
    change, message = MESHOPT_FAULTS[fault]
    with pytest.raises(InputError, match=message):
        load_mesh(altered(by_meshopt, change, tmp_path))


def every_primitive(change):
    def apply(gltf):
        for primitive in (p for p in list_primitives(gltf) if "extensions" in p):
            change(gltf, primitive["extensions"][DRACO], primitive)

    return apply


DRACO_FAULTS = {
    "view": (every_primitive(lambda g, e, p: e.update(bufferView=999)), "to be one of .* bufferViews, found 999"),
    "other view": (every_primitive(lambda g, e, p: e.update(bufferView=0)), "expected a file that can be read, found"),
    "id": (every_primitive(lambda g, e, p: e["attributes"].update(POSITION=77)), "in attribute 77 of its Draco data"),
    "no attributes": (every_primitive(lambda g, e, p: e.pop("attributes")), "'attributes' in each of"),
    "indices": (
        every_primitive(lambda g, e, p: g["accessors"][p["indices"]].update(count=3)),
        "in indices of its Draco data",
    ),
    "huge": (  # refused before anything is allocated
        lambda g: [accessor.update(count=2**31) for accessor in g["accessors"] if "bufferView" not in accessor],
        "bytes when it is unpacked",
    ),
}


def test_draco_without_indices_gives_its_attributes(plain, by_draco, tmp_path):
    """Without an accessor of indices the vertices are drawn in order."""
    path = altered(by_draco, every_primitive(lambda g, e, p: p.pop("indices")), tmp_path)
    found, expected = load_mesh(path).vertices, load_mesh(plain).vertices
    for bound in (np.min, np.max):
        np.testing.assert_allclose(bound(found, axis=0), bound(expected, axis=0), atol=1e-3)


@pytest.mark.parametrize("fault", DRACO_FAULTS)
def test_contradictory_draco_is_refused(fault, by_draco, tmp_path):
    change, message = DRACO_FAULTS[fault]
    path = altered(by_draco, change, tmp_path)
    with pytest.raises(InputError, match=message) as caught:
        load_mesh(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_elements_of_draco_start_at_multiples_of_four_bytes(tmp_path):
    sample = samples.hero()
    for primitive in list_primitives(sample.gltf):
        count = sample.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
        primitive["attributes"]["COLOR_0"] = sample.accessor(np.full((count, 3), 200), "u1", normalized=True)
    document = open_document(draco_glb(sample.glb(tmp_path / "plain.glb"), tmp_path / "small.glb"))
    accessors, views = document.gltf["accessors"], document.gltf["bufferViews"]
    colors = [primitive["attributes"]["COLOR_0"] for primitive in list_primitives(document.gltf)]
    assert 4 in {views[accessors[k]["bufferView"]].get("byteStride") for k in colors}  # strips are not compressed
    assert {tuple(row) for k in colors for row in read_accessor(document, k).tolist()} == {(200, 200, 200)}
