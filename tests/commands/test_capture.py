"""The command `mimesh capture`: its output, what it prints, and what it refuses."""

import json

from people import walk

from mimesh.io import save_clip


def test_a_clip_becomes_a_bvh(tmp_path, monkeypatch, call, refuses):
    monkeypatch.chdir(tmp_path)
    save_clip(walk(frames=4), tmp_path / "walk.npz")
    ended = call("capture walk.npz")
    assert ended.out.startswith("walk.bvh: 31 joints of a person, found, confidence 0.")
    assert "4 frames at 10 per second" in ended.out
    assert "next: mimesh animate hero.glb walk.bvh" in ended.out
    facts = json.loads(call("capture walk.npz --start 1 --json").out)
    assert (facts["frames"], facts["joints"], facts["replaced"]) == (3, 31, True)
    assert (tmp_path / "walk.bvh").read_text().count("\n0.") <= 3 + facts["frames"]
    refuses("capture walk.npz --no-clobber", "walk.bvh")
    refuses("capture walk.npz -o out.obj", "out.obj: expected an output in one of .bvh .fbx .glb .gltf .vrma, found")
