"""Several clips in the file of an identity with a rig, and layouts that its rig cannot have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed

from mimesh import pipeline
from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.options import Hints
from mimesh.io import load_clip
from mimesh.io.gltf.document import open_document
from mimesh.pipeline import animate
from mimesh.pipeline.skinned import save_skinned


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    """Write person 0 with a clip, in a T-pose, with our names."""
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def test_a_copy_and_a_retargeted_clip_go_into_one_file(model, driving, tmp_path):
    identity = rigs.of_kind(tmp_path / "a.glb", "T-pose", shape=1, name=renamed("unreal"))[0]
    results = [animate(str(identity), str(clip), model) for clip in (identity, driving)]
    assert [result.report.get("copied") for result in results] == [True, None]
    save_skinned(results, tmp_path / "out.glb", animations=["own", "other"])
    for name, result in zip(("own", "other"), results, strict=True):
        written = load_clip(tmp_path / "out.glb", animation=name)
        np.testing.assert_allclose(written.vertices, result.clip.vertices, atol=2e-5)


@pytest.mark.parametrize("suffix", ["glb", "vrma"])
def test_results_of_several_identities_are_refused(suffix, model, driving, tmp_path):
    """Also where both have the same number of nodes, vertices and joints, so that one could be written as the other."""
    paths = [rigs.character(tmp_path / f"{k}.glb", k, name=renamed("unreal")) for k in (0, 1)]
    results = [animate(str(path), str(driving), model) for path in paths]
    with pytest.raises(
        InputError, match=r"expected results of one identity, found \S*0.glb and \S*1.glb; write a file"
    ):
        save_skinned(results, tmp_path / f"out.{suffix}")


def test_a_result_on_the_rig_and_one_on_the_surface_are_refused(model, driving, tmp_path):
    identity = rigs.character(tmp_path / "a.glb", name=renamed("unreal"))
    results = [animate(str(identity), str(driving), model, hints=Hints(rig=rig)) for rig in ("own", "mimesh")]
    for given, names in ((results, ["first", "second"]), (results[::-1], ["second", "first"])):
        message = r"^second: .* of the identity's own bones, as that of first, .*rig=\"mimesh\""
        with pytest.raises(InputError, match=message):
            save_skinned(given, tmp_path / "out.glb", animations=names)


@pytest.mark.parametrize(
    ("person", "options", "message"),
    [
        (True, ("--rest", "T"), "expected `--rest file` for"),
        (False, ("--names", "unreal"), "--names, --root-bone: expected the bones of a person in"),
        (False, ("--root-bone",), "--names, --root-bone: expected the bones of a person in"),
    ],
)
def test_layouts_that_the_rig_cannot_have_are_refused_before_it_moves(
    person, options, message, model, driving, tmp_path, monkeypatch, capsys
):
    def fail(*args, **kwargs):
        raise AssertionError("moved")

    monkeypatch.setattr(pipeline, "animate", fail)
    names = renamed("unreal") if person else lambda name: f"bone {len(name)} {sum(map(ord, name))}"
    identity = rigs.of_kind(tmp_path / "a.glb", "T-pose", name=names)[0]
    clip = driving if person else identity
    words = ["animate", identity, clip, "-o", tmp_path / "out.glb", "-m", model, "--no-preview", *options]
    assert run([str(word) for word in words]) == 2
    assert message in capsys.readouterr().err
    assert run([str(word) for word in (*words, "--rig", "mimesh")]) != 2  # reaches the work, which fails


def test_names_of_a_file_that_two_clips_share(model, driving, tmp_path):
    """The command reads the identity once for each clip."""
    identity = rigs.character(tmp_path / "a.glb", name=renamed("biped"))
    other = rigs.of_kind(tmp_path / "b.glb", "T-pose", shape=1)[0]
    words = [
        "animate",
        identity,
        driving,
        other,
        "-o",
        tmp_path / "out.glb",
        "-m",
        model,
        "--no-preview",
        "--root-bone",
    ]
    assert run([str(word) for word in words]) == 0
    gltf = open_document(tmp_path / "out.glb").gltf
    assert [animation["name"] for animation in gltf["animations"]] == ["move", "b"]
    again = [tmp_path / "out.glb" if word == identity else tmp_path / "2.glb" if word == tmp_path / "out.glb" else word
             for word in words[:-1]]  # fmt: skip
    assert run([str(word) for word in again]) == 0
    twice = [animation["name"] for animation in open_document(tmp_path / "2.glb").gltf["animations"]]
    assert twice == ["move-2", "b-2", "move", "b"]
    assert gltf["nodes"][-1]["name"] == "Root"
