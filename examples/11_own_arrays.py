"""Use arrays of your own program: vertices and triangles in; vertices, joints and figures out, without a file between.

python examples/11_own_arrays.py                       # arrays of a shipped character and of a shipped motion
python examples/11_own_arrays.py arrays.npz -o moved   # yours: vertices, faces, driving_vertices, driving_faces, fps

The types are those that mypy --strict and pyright know: see docs/api.md.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import mimesh
from mimesh.bodies import character, load_body
from mimesh.tools.demo import driving_clip

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.integer]


def move(
    vertices: FloatArray, faces: IntArray, driving: FloatArray, driving_faces: IntArray, fps: float
) -> tuple[FloatArray, dict[str, FloatArray], float | None]:
    """Move a mesh by a clip; all arrays are in axes and units of their own.

    Args:
        vertices: of the mesh to move, (V, 3).
        faces: its triangles, (F, 3), indices from 0.
        driving: frames of the driving mesh, (T, U, 3).
        driving_faces: its triangles.
        fps: frames a second of the driving.

    Returns:
        The mesh in every frame, (T, V, 3); its joints, each (T, 3); and the confidence, None where joints are known.
    """
    identity = mimesh.Mesh(vertices, faces, name="identity")
    clip = mimesh.Clip(mimesh.Mesh(driving[0], driving_faces, name="driving"), driving, fps)
    result = mimesh.animate(identity, clip)
    for note in result.notes:
        print("note:", note)
    joints: dict[str, FloatArray] = {}
    if result.skeleton is not None:
        positions = result.skeleton.joint_positions()  # (T, J, 3)
        joints = {name: positions[:, j] for j, name in enumerate(result.skeleton.names)}
    return result.clip.vertices, joints, result.report["identity"].get("confidence")


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arrays", nargs="?", type=Path, help="an .npz file of arrays")
    parser.add_argument("--frames", type=int, default=None, help="number of frames to use")
    parser.add_argument("-o", "--output", type=Path, default=Path("11_own_arrays"), help="folder")
    options = parser.parse_args(argv)
    arrays: dict[str, NDArray[Any]] = dict(np.load(options.arrays)) if options.arrays else shipped_arrays()
    try:
        moved, joints, confidence = move(
            arrays["vertices"],
            arrays["faces"],
            arrays["driving_vertices"][: options.frames],
            arrays["driving_faces"],
            float(arrays["fps"]),
        )
    except mimesh.InputError as error:  # one line: what was expected, what was found, what to do
        raise SystemExit(str(error)) from error
    print(f"{moved.shape} vertices, {len(joints)} joints, confidence {confidence}")
    options.output.mkdir(parents=True, exist_ok=True)
    positions, names = np.array(list(joints.values())), np.array(list(joints))  # (J, T, 3) and (J,)
    np.savez(options.output / "moved.npz", vertices=moved, joints=positions, names=names)
    print("wrote", options.output / "moved.npz")


def shipped_arrays() -> dict[str, NDArray[Any]]:
    """Return the arrays of a shipped character and of a shipped motion."""
    identity, clip = character("runner"), driving_clip(load_body())
    return {
        "vertices": identity.vertices,
        "faces": identity.faces,
        "driving_vertices": clip.vertices,
        "driving_faces": clip.mesh.faces,
        "fps": np.array(clip.fps),
    }


if __name__ == "__main__":
    main()
