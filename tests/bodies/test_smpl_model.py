"""Body models in SMPL's layout: files of all kinds give the same model, which poses as plain loops do."""

from __future__ import annotations

import dataclasses
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from smpl_files import Ch, chumpy_modules, loop_vertices, small_arrays, smpl_arrays, write_model

from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.bodies.smpl_model import ARRAYS, load_smpl_model
from mimesh.core.errors import InputError

LAYOUTS = {"smpl.pkl": (24, 10), "smpl.npz": (24, 300), "smplh.npz": (52, 16), "smal.pkl": (33, 41)}
"""Numbers of joints and shape coefficients."""


def posed(model, betas, rotvec, trans):
    return model.posed(betas, rotvec_to_rotmat(rotvec), trans)


@pytest.mark.parametrize("seed", range(2))
def test_posed_vertices_are_those_of_plain_loops(seed, tmp_path):
    rng = np.random.default_rng(seed)
    arrays = small_arrays(joints=3 + 2 * seed, seed=seed)
    model = load_smpl_model(write_model(tmp_path / "m.npz", arrays))
    betas, trans = rng.standard_normal(2), rng.standard_normal((40, 3))
    rotvec = rng.standard_normal((40, 3 + 2 * seed, 3))
    expected = [loop_vertices(arrays, betas, *frame) for frame in zip(rotvec, trans, strict=True)]
    np.testing.assert_allclose(posed(model, betas, rotvec, trans), expected, atol=1e-12)
    frames = list(model.frames(betas, rotvec_to_rotmat(rotvec), trans))  # in more than one chunk
    np.testing.assert_allclose(frames, expected, atol=1e-12)


@pytest.mark.parametrize("name", LAYOUTS)
def test_models_of_all_layouts_are_posed_as_by_loops(name, tmp_path):
    joints, shapes = LAYOUTS[name]
    arrays, rng = smpl_arrays(joints, shapes, faces=300), np.random.default_rng(1)
    model = load_smpl_model(write_model(tmp_path / name, arrays))
    assert (len(model.faces), len(model.parents)) == (len(arrays["f"]), joints)
    betas, rotvec, trans = rng.standard_normal(shapes), 0.5 * rng.standard_normal((1, joints, 3)), rng.random((1, 3))
    expected = loop_vertices(arrays, betas, rotvec[0], trans[0])
    np.testing.assert_allclose(posed(model, betas, rotvec, trans)[0], expected, atol=1e-9)


REGRESSORS = {
    "dense": np.asarray, "matrix": np.matrix, "csc": sp.csc_matrix, "csr": sp.csr_matrix, "coo": sp.coo_matrix,
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:the matrix subclass")
@pytest.mark.parametrize("kind", REGRESSORS)
@pytest.mark.parametrize("protocol", [0, 5])
def test_pickles_give_the_model_of_the_archive(kind, protocol, tmp_path):
    arrays = small_arrays()
    true = load_smpl_model(write_model(tmp_path / "m.npz", arrays))
    entries = {**arrays, "J_regressor": REGRESSORS[kind](arrays["J_regressor"]), "bs_style": "lbs"}
    with chumpy_modules():
        entries["shapedirs"] = Ch(arrays["shapedirs"])
        (tmp_path / "m.pkl").write_bytes(pickle.dumps(entries, protocol))
    same_model(load_smpl_model(tmp_path / "m.pkl"), true)


def ramp(*shape: int) -> np.ndarray:
    return np.arange(float(np.prod(shape))).reshape(shape) / 8


@pytest.mark.parametrize("protocol", [0, 2])
def test_pickles_of_python_2_with_chumpy_are_read_exactly(protocol):
    """Files that Python 2.7.18 wrote with NumPy 1.16.6, SciPy 1.2.3 and chumpy 0.70 from numbers in a row.

    The template and the weights are chumpy's variables, the shape directions a part of one.
    """
    model = load_smpl_model(Path(__file__).with_name(f"python2_model_{protocol}.pkl"))
    template, directions = ramp(5, 3), ramp(5, 3, 4)[..., :2]
    np.testing.assert_array_equal(model.vertices, template)
    np.testing.assert_array_equal(model.components, np.moveaxis(directions, 2, 0))
    np.testing.assert_array_equal(model.pose_directions, ramp(5, 3, 9))
    np.testing.assert_allclose(model.joints, ramp(2, 5) @ template, rtol=1e-12)
    np.testing.assert_allclose(model.joint_components, np.einsum("jv,vck->kjc", ramp(2, 5), directions), rtol=1e-12)
    np.testing.assert_array_equal(model.weights, ramp(5, 2))
    assert model.parents == (-1, 0)
    assert model.faces.tolist() == [[0, 1, 2], [2, 3, 4]]


def same_model(model, true):
    for field in dataclasses.fields(true):
        np.testing.assert_array_equal(getattr(model, field.name), getattr(true, field.name), err_msg=field.name)


@pytest.mark.parametrize("kind", ["csc", "csr", "coo"])
def test_an_archive_may_hold_a_sparse_regressor_as_an_object(kind, tmp_path):
    arrays = small_arrays()
    true = load_smpl_model(write_model(tmp_path / "m.npz", arrays))
    write_model(tmp_path / "m.npz", {**arrays, "J_regressor": np.array(REGRESSORS[kind](arrays["J_regressor"]))})
    same_model(load_smpl_model(tmp_path / "m.npz"), true)


@pytest.mark.parametrize(
    "root", [np.int64(-1), np.int64(2**32 - 1), np.uint32(2**32 - 1), np.uint64(2**64 - 1), np.int32(-1)]
)
def test_the_root_has_no_parent_in_any_type_and_parents_are_found_by_the_numbers_of_joints(root, tmp_path):
    arrays = small_arrays()
    table = (arrays["kintree_table"] + 7).astype(type(root))
    table[0, 0] = root
    model = load_smpl_model(write_model(tmp_path / "m.npz", {**arrays, "kintree_table": table}))
    assert model.parents == (-1, *arrays["kintree_table"][0, 1:].tolist())


def write_arrays(path: Path, arrays: dict) -> Path:
    """Write arrays as they are: an archive, or a plain pickle."""
    np.savez(path, **arrays) if path.suffix == ".npz" else path.write_bytes(pickle.dumps(arrays, 2))
    return path


class Malicious:
    def __reduce__(self):
        return os.system, ("touch /tmp/never",)


def changed(name: str, change) -> dict:
    arrays = small_arrays()
    arrays[name] = change(arrays[name])
    return arrays


def table(*parents: int) -> dict:
    return {**small_arrays(), "kintree_table": np.array([parents, range(5)])}


def nan_at(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values.reshape(-1)[3] = np.nan
    return values


WRONG = {
    "template of points in the plane": (changed("v_template", lambda v: v[:, :2]), r"'v_template' .*\(any, 3\)"),
    "no vertices": (changed("v_template", lambda v: v[:0]), r"'v_template'"),
    "shapes of other vertices": (changed("shapedirs", lambda v: v[:-1]), r"'shapedirs' .*\(12, 3, any\), .*11, 3, 3\)"),
    "flat shapes": (changed("shapedirs", lambda v: v.reshape(36, 3)), "'shapedirs'"),
    "poses of other joints": (changed("posedirs", lambda v: v[..., :-9]), r"'posedirs' .*\(12, 3, 36\), .*12, 3, 27\)"),
    "transposed regressor": (changed("J_regressor", lambda v: v.T), "'J_regressor'"),
    "weights of other joints": (changed("weights", lambda v: v[:, :-1]), r"'weights' .*\(12, 5\), found .*\(12, 4\)"),
    "text": (changed("weights", lambda v: v.astype(str)), "'weights'"),
    "NaN": (changed("posedirs", nan_at), "NaN or infinity in 'posedirs'"),
    "infinity": (changed("v_template", lambda v: v * np.inf), "NaN or infinity in 'v_template'"),
    "quads": (changed("f", lambda v: np.zeros((3, 4), int)), r"'f' .*\(3, 4\)"),
    "no faces": (changed("f", lambda v: v[:0]), "'f'"),
    "a face beyond the vertices": (changed("f", lambda v: v + 12), r"'f' in 0\.\.11"),
    "a negative face": (changed("f", lambda v: v - 12), r"'f' in 0\.\.11"),
    "real faces": (changed("f", lambda v: v * 1.0), "'f'"),
    "a tree of other joints": (changed("kintree_table", lambda v: v[:, :-1]), "'kintree_table'"),
    "a tree of one row": (changed("kintree_table", lambda v: v[0]), "'kintree_table'"),
    "a joint above itself": (table(-1, 0, 2, 1, 1), "found 2 as the parent of joint 2"),
    "a circle": (table(-1, 0, 3, 2, 1), "found 3 as the parent of joint 2"),
    "a child before its parent": (table(-1, 0, 4, 1, 1), "found 4 as the parent of joint 2"),
    "two roots": (table(-1, 0, 1, -1, 1), "found -1 as the parent of joint 3"),
    "no root": (table(1, 0, 1, 1, 1), "found 1 as the parent of joint 0"),
    "a parent that is no joint": (table(-1, 0, 9, 1, 1), "found 9 as the parent of joint 2"),
    "a root below no joint": (table(77, 0, 1, 1, 1), "found 77 as the parent of joint 0"),
    "one number for two joints": (
        {**small_arrays(), "kintree_table": np.array([[-1, 0, 0, 1, 1], [0, 1, 1, 2, 3]])}, "'kintree_table'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("suffix", [".pkl", ".npz"])
def test_wrong_models_give_one_line(name, suffix, tmp_path):
    arrays, message = WRONG[name]
    path = write_arrays(tmp_path / f"m{suffix}", arrays)
    with pytest.raises(InputError, match=message) as error:
        load_smpl_model(path)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(f"{path}: expected ")


@pytest.mark.parametrize("suffix", [".pkl", ".npz"])
def test_missing_arrays_are_named(suffix, tmp_path):
    for name in ARRAYS:
        path = write_arrays(tmp_path / f"m{suffix}", {k: v for k, v in small_arrays().items() if k != name})
        with pytest.raises(InputError, match=f"expected the arrays {name}, found "):
            load_smpl_model(path)


def test_a_malicious_object_in_a_model_is_refused_by_name(tmp_path):
    (tmp_path / "m.pkl").write_bytes(pickle.dumps({**small_arrays(), "extra": Malicious()}))
    np.savez(tmp_path / "m.npz", **{**small_arrays(), "J_regressor": np.array([Malicious()], object)})
    for path in (tmp_path / "m.pkl", tmp_path / "m.npz"):
        with pytest.raises(InputError, match="system"):
            load_smpl_model(path)


def test_odd_names_of_arrays_stay_on_one_line(tmp_path):
    (tmp_path / "m.pkl").write_bytes(pickle.dumps({"a\nb": 1, 7: 2, b"c": 3}))
    with pytest.raises(InputError, match=r"found a\\nb, 7, c; ") as error:
        load_smpl_model(tmp_path / "m.pkl")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["none.pkl", "none.npz", "m.obj"])
def test_other_files_are_refused(name, tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"expected a body model as \.pkl or \.npz"):
        load_smpl_model(tmp_path / name)
