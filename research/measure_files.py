"""Measure whether files of many makers are moved: each is looked at, rigged, animated, and read back by another reader.

    python research/measure_files.py FOLDER --bvh FILE --gltf FILE --animal FILE [-o benchmarks/files.json]
        [--sheets FOLDER] [--written FOLDER] [--only WORD ...] [--resume]

FOLDER has a `list.json`: a list of objects with `file` (within FOLDER), `maker`, `kind` (person, animal, thing, scene)
and more facts, which go into the report as they are. Files are measured in another process, each within --seconds.
Animals get the clip of --animal in place of --gltf, and should refuse the BVH, which is a person's.

Written .glb files are read with pygltflib and NumPy alone: every vertex that the scene shows, by linear blend skinning.
The result is compared with the frames that the tool has in memory: the largest distance from a vertex to the nearest
vertex of the other, both ways, over the diagonal of the mesh; what the tool says itself of a found rig's file
(`skinned_deviation`) is allowed. Verdicts are "right" (at least one clip moved it, as it should), "refused" (by both,
with the message) and "wrong" (with the reasons).
`--sheets` gets pictures of 20 files each: at rest, then frames by the BVH, then frames by the glTF clip.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from mimesh import FrameRange, InputError, animate, load_mesh, rig
from mimesh.core.animated_rig import AnimatedRig
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import descendants
from mimesh.evaluate.provenance import commit, machine
from mimesh.io.atomic import whole_file
from mimesh.io.gltf.edit import GltfSource
from mimesh.io.usd import TO_Y_UP
from mimesh.pipeline.gltf_rigs import rig_facts
from mimesh.pipeline.result import ClipResult
from mimesh.pipeline.rigging import RiggedMesh
from mimesh.tools.inspect import inspect_file

SAME = 1e-4
"""Largest distance, over the diagonal of the mesh, of what another reader reads from what the tool has in memory."""
FLOOR = 0.012
"""Largest median distance of a person's soles from the floor that they have at rest, over the height: 2 cm of 1.7 m."""
STANDS = 0.8
"""Vertical extent at rest, over that of the result, of a person who rests standing."""
FRAMES = 24
"""Frames of each driving clip."""
COMPARED = 5
"""Of these, frames that are read back."""
TILE = (112, 128)
"""Width and height of a picture in pixels; SHOWN are drawn of each result."""
SHOWN = 3
FILES_OF_A_SHEET = 20
NUMBERS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Of glTF accessors: what their types are for NumPy, and numbers in a row."""


def main() -> None:
    """Measure all files of the list, and write the report after each, so that a stop loses nothing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--bvh", type=Path, required=True)
    parser.add_argument("--gltf", type=Path, required=True)
    parser.add_argument("--animal", type=Path, required=True, help="clip of a four-legged animal")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/files.json"))
    parser.add_argument("--sheets", type=Path)
    parser.add_argument("--written", type=Path, help="keep the written files here")
    parser.add_argument("--seconds", type=float, default=180.0, help="time limit of each file")
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="files with one of these in their paths")
    parser.add_argument("--resume", action="store_true", help="keep what the report has, of a measurement that stopped")
    args = parser.parse_args()
    listed = json.loads((args.folder / "list.json").read_text())
    listed = [row for row in listed if not args.only or any(word in row["file"] for word in args.only)]
    with tempfile.TemporaryDirectory() as scratch:
        written = args.written or Path(scratch)
        written.mkdir(parents=True, exist_ok=True)
        rows = json.loads(args.output.read_text())["files"] if args.resume else []
        done, worker = {row["file"] for row in rows}, _worker()
        for entry in (entry for entry in listed if entry["file"] not in done):
            row, worker = _measured(entry, args, written, worker)
            rows.append(entry | row)
            print(f"{row['verdict']:8} {entry['file']}: {'; '.join(row['why'])[:160]}", flush=True)
            report = {"commit": commit(), "machine": machine(), "makers": _table(rows), "files": rows}
            with whole_file(args.output) as temporary:
                # Messages name files as the list does, wherever the folder is.
                temporary.write_text(json.dumps(report, indent=1).replace(f"{args.folder}/", "") + "\n")
        worker.terminate()
        if args.sheets:
            draw_sheets(rows, written, args.sheets)
    print(json.dumps(_table(rows), indent=1))


def _worker():
    """Return a pool of one process, in which a crash does not end the measurement."""
    return multiprocessing.get_context("spawn").Pool(1)


def _measured(entry: dict[str, Any], args: argparse.Namespace, written: Path, worker) -> tuple[dict[str, Any], Any]:
    """Measure a file in the worker; return its verdict, and the worker, a new one after a crash or the time limit."""
    drivings = {"bvh": args.bvh, "gltf": args.animal if entry["kind"] == "animal" else args.gltf}
    words = (args.folder / entry["file"], drivings, _stem(entry, written), entry["kind"] == "person")
    begin = time.perf_counter()
    try:
        row = worker.apply_async(measure_file, words).get(args.seconds)
    except multiprocessing.TimeoutError:  # a process that crashed is found so, too
        worker.terminate()
        row, worker = {"verdict": "wrong", "why": [f"crashed, or took more than {args.seconds:g} s"]}, _worker()
    return row | {"seconds": round(time.perf_counter() - begin, 2)}, worker


def _stem(entry: dict[str, Any], written: Path) -> str:
    """Return the beginning of the paths of what is written of a file."""
    return str(written / entry["file"].replace("/", "__"))


def measure_file(path: Path, drivings: dict[str, Path], stem: str, person: bool) -> dict[str, Any]:
    """Look at a file, rig it where it has no rig, animate it by both clips, and judge each step."""
    steps: dict[str, dict[str, Any]] = {}
    mesh = _step(steps, "look", lambda: _look(path))
    pictures = [] if mesh is None else [_picture(Clip.still(mesh), 1, "y", None)]
    if mesh is not None:
        facts = rig_facts(mesh)
        if facts is None or not facts.used:
            _step(steps, "rig", lambda: _rig(mesh, Path(f"{stem}.rig.glb")))
        for name, driving in drivings.items():
            if "refused" in steps.get("rig", {}) and name == "gltf":
                continue  # one refusal of a shape tells as much as three
            output = Path(f"{stem}.{name}.glb")
            result = _step(steps, name, lambda d=driving, o=output: _animate(mesh, d, o, person))
            if result is not None:
                facing = result.report["identity"]
                clip = Clip(result.mesh, _frames(result, SHOWN), result.fps)
                pictures.append(_picture(clip, SHOWN, facing["up"], facing["front"]))
    _save_pictures(pictures, Path(f"{stem}.png"))
    why = [f"{name}: {reason}" for name, step in steps.items() for reason in step["why"]]
    refused = [f"{name}: {step['refused']}" for name, step in steps.items() if "refused" in step]
    moved = any(name in steps and "refused" not in steps[name] for name in drivings)
    verdict = "wrong" if why else "right" if moved else "refused"
    return {"verdict": verdict, "why": why or refused, "steps": steps}


def _step(steps: dict[str, dict[str, Any]], name: str, run: Callable[[], tuple[Any, dict[str, Any]]]) -> Any:
    """Take one step: `run` returns what is used further, and figures. An exception other than `InputError` is wrong."""
    begin = time.perf_counter()
    row: dict[str, Any] = {"why": []}
    found = None
    try:
        found, figures = run()
        row |= figures
    except InputError as error:
        row["refused"] = str(error)
    except Exception as error:  # that there is none is what is measured
        row["why"].append(repr(error))
    steps[name] = row | {"seconds": round(time.perf_counter() - begin, 2)}
    return found


def _look(path: Path) -> tuple[Mesh, dict[str, Any]]:
    facts = inspect_file(path)
    mesh = load_mesh(path)
    known = rig_facts(mesh)
    text = None if known is None else known.text
    figures = {"vertices": facts.vertices, "rig": text, "stands": facts.stands, "warnings": facts.warnings()}
    why = [] if np.isfinite(mesh.vertices).all() else ["vertices that are not finite"]
    return mesh, figures | {"why": why}


def _rig(mesh: Mesh, output: Path) -> tuple[RiggedMesh, dict[str, Any]]:
    """Rig a mesh, write it, and compare what is read back at rest with the mesh."""
    rigged = rig(mesh)
    rigged.save(output)
    shown = rigged.skeleton.mesh
    apart = _apart(read_frames(output, [None])[0], _standing(shown, shown.vertices))
    why = [] if apart <= SAME else [f"at rest {apart:.2g} of the size apart"]
    return rigged, {"body": rigged.body, "apart": apart, "why": why, "notes": rigged.notes}


def _animate(mesh: Mesh, driving: Path, output: Path, person: bool) -> tuple[ClipResult, dict[str, Any]]:
    """Animate a mesh, write it, and judge what is read back."""
    result = animate(mesh, driving, frames=_range(driving))
    saved = result.save_skinned(output)
    chosen = np.linspace(0, len(result.frames) - 1, COMPARED).round().astype(int).tolist()
    truth = [_standing(result.mesh, np.asarray(frame, float)) for frame in result.frames.at(chosen)]
    read = read_frames(output, [k / result.fps for k in chosen])
    apart = max(_apart(theirs, ours) for theirs, ours in zip(read, truth, strict=True))
    told = saved.deviations[0].get("skinned_deviation", 0.0)
    why = [] if apart <= max(SAME, 1.1 * told) else [f"{apart:.2g} of the size from the result's frames"]
    why += [] if all(np.isfinite(frame).all() for frame in (*read, *truth)) else ["vertices that are not finite"]
    low = _floor(mesh, result)
    if person and np.median(np.abs(low)) > FLOOR:
        why.append(f"soles {np.median(low):+.3f} of the height from the floor")
    figures = {"apart": apart, "told": told, "own": result.own is not None, "fps": result.fps}
    figures |= {"cause": saved.deviations[0].get("deviation_cause")}
    figures |= {"low": round(float(np.median(low)), 4), "stretch": _stretch(mesh, truth), "notes": result.notes}
    return result, figures | {"why": why}


def _standing(mesh: Mesh, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Turn a mesh as a glTF file shows it: y up, unless it keeps the nodes of a glTF file."""
    axis, degrees = TO_Y_UP[(None if isinstance(mesh.source, GltfSource) else mesh.up) or "+y"]
    return Rotation.from_euler(axis, degrees, degrees=True).apply(vertices)


def _range(driving: Path) -> FrameRange:
    """Return FRAMES frames of a clip: 4 a second of a BVH, which are long and made at 100 Hz or more."""
    step = 25 if driving.suffix.lower() == ".bvh" else 1
    return FrameRange(stop=FRAMES * step, step=step)


def _floor(mesh: Mesh, result: ClipResult) -> Float[np.ndarray, " T"]:
    """Return the height of the lowest vertex of the feet over that at rest in every frame, over the height of the mesh.

    Who rests sitting or lying is on the floor with something else: then it is the lowest vertex of all at rest.
    """
    up = result.report["identity"]["up"]
    axis, sign = "xyz".index(up[-1]), -1.0 if up.startswith("-") else 1.0
    feet = _feet(result.skeleton)
    rest = sign * mesh.vertices[:, axis]
    frames = sign * _frames(result, len(result.frames))[..., axis]
    height = np.median(np.ptp(frames, axis=1))
    floor = rest[feet].min() if np.ptp(rest) > STANDS * height else rest.min()
    return (frames[:, feet].min(axis=1) - floor) / height


def _feet(skeleton: AnimatedRig | None) -> Int[np.ndarray, " N"] | slice:
    """Return the vertices that feet and toes move: hands and weapons may hang lower. All, if none are known."""
    if skeleton is None:
        return slice(None)
    roles = skeleton.person or {name: j for j, name in enumerate(skeleton.names)}
    below = descendants([roles[name] for name in ("LeftFoot", "RightFoot") if name in roles], skeleton.parents)
    joints, weights = skeleton.strongest()
    found = np.flatnonzero(np.isin(joints[:, 0], below) & (weights[:, 0] > 0))
    return found if len(found) else slice(None)


def _stretch(mesh: Mesh, frames: list[Float[np.ndarray, "V 3"]]) -> float:
    """Return how many times longer than at rest edges get: percentile 99.9, of edges longer than 0.2 % of the size."""
    if not len(mesh.faces):
        return 1.0
    edges = np.unique(np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    lengths = [np.linalg.norm(v[edges[:, 0]] - v[edges[:, 1]], axis=1) for v in (mesh.vertices, *frames)]
    kept = lengths[0] > 0.002 * _size(mesh.vertices)
    return round(
        max((float(np.percentile(x[kept] / lengths[0][kept], 99.9)) for x in lengths[1:] if kept.any()), default=1.0), 3
    )


def _frames(result: ClipResult, count: int) -> Float[np.ndarray, "T V 3"]:
    """Return frames of a result, evenly spread."""
    chosen = np.linspace(0, len(result.frames) - 1, count).round().astype(int).tolist()
    return np.stack([np.asarray(frame) for frame in result.frames.at(chosen)])


def _size(vertices: Float[np.ndarray, "V 3"]) -> float:
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _apart(read: Float[np.ndarray, "U 3"], ours: Float[np.ndarray, "V 3"]) -> float:
    """Return the largest distance from a vertex to the nearest of the other set, both ways, over the size."""
    from scipy.spatial import KDTree

    if not len(read) or not np.isfinite(read).all():
        return float("inf")
    there, back = KDTree(ours).query(read)[0].max(), KDTree(read).query(ours)[0].max()
    return float(max(there, back) / _size(ours))


def read_frames(path: Path, seconds: list[float | None]) -> list[Float[np.ndarray, "V 3"]]:
    """Return all vertices of the scene of a .glb in its first animation at each time; None is the file at rest."""
    import pygltflib

    gltf = pygltflib.GLTF2.load_binary(str(path))
    assert gltf is not None, f"{path} is no .glb"
    file = _File(gltf, gltf.binary_blob() or b"")
    return [file.vertices(None if t is None else max(t, 0.0)) for t in seconds]


class _File:
    """A .glb as the specification reads it (glTF 2.0): accessors, animations, morph targets and skins."""

    def __init__(self, gltf, binary: bytes) -> None:
        self.gltf, self.binary = gltf, binary
        self.parents = {child: k for k, node in enumerate(gltf.nodes) for child in node.children or []}

    def view(self, index: int, offset: int, dtype: str, count: int, width: int) -> np.ndarray:
        """Return rows of a buffer view, which may have a stride."""
        view, size = self.gltf.bufferViews[index], np.dtype(dtype).itemsize
        begin = (view.byteOffset or 0) + (offset or 0)
        strides = (view.byteStride or width * size, size)
        return np.ndarray((count, width), dtype, self.binary, begin, strides).copy()

    def array(self, index: int) -> np.ndarray:
        """Return an accessor as numbers (N, width), with its sparse entries; normalised integers are fractions."""
        accessor = self.gltf.accessors[index]
        dtype, width = NUMBERS[accessor.componentType], WIDTHS[accessor.type]
        rows = np.zeros((accessor.count, width), dtype)
        if accessor.bufferView is not None:
            rows = self.view(accessor.bufferView, accessor.byteOffset, dtype, accessor.count, width)
        if sparse := accessor.sparse:
            at = NUMBERS[sparse.indices.componentType]
            places = self.view(sparse.indices.bufferView, sparse.indices.byteOffset, at, sparse.count, 1)[:, 0]
            rows[places] = self.view(sparse.values.bufferView, sparse.values.byteOffset, dtype, sparse.count, width)
        if accessor.normalized and accessor.componentType != 5126:
            return np.maximum(rows / np.iinfo(rows.dtype).max, -1.0)
        return rows if rows.dtype.kind == "u" else rows.astype(float)

    def vertices(self, seconds: float | None) -> Float[np.ndarray, "V 3"]:
        """Return all vertices that the scene shows, at a time of the first animation."""
        moved = {} if seconds is None or not self.gltf.animations else self._animated(self.gltf.animations[0], seconds)
        scene = self.gltf.scenes[self.gltf.scene or 0]
        shown, queue = [], list(scene.nodes or [])
        while queue:
            shown.append(queue.pop(0))
            queue += self.gltf.nodes[shown[-1]].children or []
        parts = [self._part(k, moved) for k in shown if self.gltf.nodes[k].mesh is not None]
        return np.concatenate([part for some in parts for part in some]) if parts else np.zeros((0, 3))

    def _animated(self, animation, seconds: float) -> dict[tuple[int, str], np.ndarray]:
        return {
            (channel.target.node, channel.target.path): self._sampled(animation, channel, seconds)
            for channel in animation.channels
            if channel.target.node is not None
        }

    def _sampled(self, animation, channel, seconds: float) -> np.ndarray:
        """Return the value of a channel at a time: STEP, LINEAR (spherical for rotations) or CUBICSPLINE."""
        sampler = animation.samplers[channel.sampler]
        times, values = self.array(sampler.input)[:, 0], self.array(sampler.output)
        cubic = sampler.interpolation == "CUBICSPLINE"
        values = values.reshape(len(times), 3 if cubic else 1, -1)
        k = int(np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, max(len(times) - 2, 0)))
        span = times[k + 1] - times[k] if len(times) > 1 else 1.0
        u = float(np.clip((seconds - times[k]) / span, 0.0, 1.0)) if len(times) > 1 else 0.0
        a, b = values[k], values[min(k + 1, len(times) - 1)]
        if cubic:
            tangents = span * (u**3 - 2 * u**2 + u) * a[2] + span * (u**3 - u**2) * b[0]
            value = (2 * u**3 - 3 * u**2 + 1) * a[1] + (3 * u**2 - 2 * u**3) * b[1] + tangents
        elif sampler.interpolation == "STEP":
            value = b[0] if u >= 1.0 else a[0]
        elif channel.target.path == "rotation":
            value = _slerp(a[0], b[0], u)
        else:
            value = (1 - u) * a[0] + u * b[0]
        return value / np.linalg.norm(value) if channel.target.path == "rotation" else value

    def world(self, k: int, moved: dict) -> Float[np.ndarray, "4 4"]:
        """Return the matrix of a node in the scene."""
        node, matrix = self.gltf.nodes[k], np.eye(4)
        if node.matrix is not None and not any((k, path) in moved for path in ("translation", "rotation", "scale")):
            matrix = np.array(node.matrix, float).reshape(4, 4).T
        else:
            at = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
            t, q, s = (np.asarray(moved.get((k, p), getattr(node, p) or at[p]), float) for p in at)
            matrix[:3, :3], matrix[:3, 3] = _matrix(q) * s, t
        return matrix if k not in self.parents else self.world(self.parents[k], moved) @ matrix

    def _part(self, k: int, moved: dict) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of each primitive of a node."""
        node, mesh = self.gltf.nodes[k], self.gltf.meshes[self.gltf.nodes[k].mesh]
        weights = moved.get((k, "weights"), getattr(node, "weights", None) or mesh.weights)
        parts = []
        for primitive in mesh.primitives:
            points = self.array(primitive.attributes.POSITION).astype(float)
            for weight, target in zip([] if weights is None else weights, primitive.targets or [], strict=False):
                index = target.get("POSITION") if isinstance(target, dict) else target.POSITION
                points += 0 if index is None or not weight else weight * self.array(index)
            parts.append(self._placed(points, node, primitive.attributes, self.world(k, moved), moved))
        return parts

    def _placed(self, points, node, attributes, placed, moved: dict) -> Float[np.ndarray, "V 3"]:
        """Place points in the scene: by the joints of a skin, else by their node."""
        homogeneous = np.c_[points, np.ones(len(points))]
        if node.skin is None or attributes.JOINTS_0 is None:
            return (homogeneous @ placed.T)[:, :3]
        skin = self.gltf.skins[node.skin]
        bind = np.tile(np.eye(4), (len(skin.joints), 1, 1))
        if skin.inverseBindMatrices is not None:
            bind = self.array(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = np.stack([self.world(j, moved) for j in skin.joints]) @ bind[: len(skin.joints)]
        total, weighed = np.zeros((len(points), 4)), np.zeros(len(points))
        for n in range(8):
            if getattr(attributes, f"JOINTS_{n}", None) is None:
                break
            index, share = (
                self.array(getattr(attributes, f"JOINTS_{n}")),
                self.array(getattr(attributes, f"WEIGHTS_{n}")),
            )
            for c in range(4):
                total += share[:, c, None] * np.einsum("nij,nj->ni", joints[index[:, c].astype(int)], homogeneous)
                weighed += share[:, c]
        return total[:, :3] / np.where(weighed > 0, weighed, 1.0)[:, None]  # as engines do, which normalise weights


def _slerp(a: np.ndarray, b: np.ndarray, u: float) -> np.ndarray:
    """Interpolate two unit quaternions along the shorter arc."""
    cosine = float(a @ b)
    b, cosine = (-b, -cosine) if cosine < 0 else (b, cosine)
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:
        return (1 - u) * a + u * b
    return (np.sin((1 - u) * angle) * a + np.sin(u * angle) * b) / np.sin(angle)


def _matrix(q: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Return the rotation matrix of a unit quaternion x, y, z, w."""
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _picture(clip: Clip, frames: int, up: str, front: str | None):
    from mimesh.view.sheet import strip

    return strip(clip, frames, TILE, clay=True, up=up, front=front, labels=False)


def _save_pictures(pictures: list, path: Path) -> None:
    """Save the pictures of a file side by side."""
    from PIL import Image

    row = Image.new("RGB", ((1 + 2 * SHOWN) * TILE[0], TILE[1]), "white")
    left = 0
    for picture in pictures:
        row.paste(picture, (left, 0))
        left += picture.width
    row.save(path)


def draw_sheets(rows: list[dict[str, Any]], pictures: Path, folder: Path) -> None:
    """Draw all files on sheets of two columns, each with its name and verdict below it."""
    from PIL import Image

    from mimesh.view.sheet import captioned, page

    folder.mkdir(parents=True, exist_ok=True)
    blank = Image.new("RGB", ((1 + 2 * SHOWN) * TILE[0], TILE[1]), "white")
    for first in range(0, len(rows), FILES_OF_A_SHEET):
        tiles = []
        for k, row in enumerate(rows[first : first + FILES_OF_A_SHEET], first):
            path = Path(f"{_stem(row, pictures)}.png")
            picture = Image.open(path).convert("RGB") if path.is_file() else blank
            label = f"{k} {row['file']} {row['verdict']} {'; '.join(row['why'])}"
            tiles.append(captioned(np.asarray(picture), label))
        page(tiles, 2).save(folder / f"files-{first // FILES_OF_A_SHEET:02d}.png")


def _table(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Count verdicts, and add seconds, by maker and of all."""
    makers = {"all": rows} | {
        maker: [r for r in rows if r["maker"] == maker] for maker in sorted({r["maker"] for r in rows})
    }
    return {
        maker: {"files": len(some)}
        | dict(Counter(row["verdict"] for row in some))
        | {"wrong by the floor alone": sum(row["verdict"] == "wrong" and _floor_alone(row) for row in some)}
        | {"seconds": round(sum(row["seconds"] for row in some), 1)}
        for maker, some in makers.items()
    }


def _floor_alone(row: dict[str, Any]) -> bool:
    return all("from the floor" in why for why in row["why"])


if __name__ == "__main__":
    main()
