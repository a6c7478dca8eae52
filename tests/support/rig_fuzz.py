"""Damages rigged files at random, and checks that every command gives a result or one line about what is wrong.

    PYTHONPATH=src:tests/support python tests/support/rig_fuzz.py FILE ... [--variants 300] [--seed 0] [--only N]

Each variant is one of the files with one to three mutations. `look`, `transfer` and `animate` run on it as identity and
as driving. A failure is an exception that is no InputError, a command of more than LONGEST_RUN seconds, or a result
that cannot be read again or has NaN.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import signal
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rigs
from networks import write_mime_network

from mimesh.cli import run
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.document import open_document

LONGEST_RUN = 20
"""Seconds that a command may take."""
MANY = 6
"""Animations of a file that are kept, so that commands are quick."""
NAMES = (
    "",
    " ",
    "a" * 5000,
    "Left\x00Arm\n\t\x1b[2J",
    "Größe 大小 \U0001f9b4",
    "\ud800",
    "mixamorig:LeftArm",
    "../../x",
    "1",
)


class NotPossible(Exception):
    """A mutation that a file has no place for."""


class Hang(BaseException):
    """A command that takes too long; no handler of exceptions may catch it."""


class RigFile:
    """A rigged glTF file whose JSON and numbers can be changed."""

    def __init__(self, path: Path) -> None:
        document = open_document(path)
        self.gltf: dict[str, Any] = copy.deepcopy(document.gltf)
        self.binary = bytearray(document.binary)
        self.gltf["animations"] = self.gltf.get("animations", [])[:MANY]
        for image in self.gltf.get("images", []):
            image.pop("uri", None)

    def some(self, rng: np.random.Generator, key: str) -> dict[str, Any]:
        """Choose an entry of a top-level list."""
        return self.gltf[key][self.index(rng, key)]

    def index(self, rng: np.random.Generator, key: str) -> int:
        """Choose the index of an entry of a top-level list."""
        if not self.gltf.get(key):
            raise NotPossible
        return int(rng.integers(len(self.gltf[key])))

    def joint(self, rng: np.random.Generator) -> int:
        """Choose the node of a joint."""
        joints = self.some(rng, "skins")["joints"]
        if not joints:
            raise NotPossible
        return int(joints[rng.integers(len(joints))])

    def values(self, accessor: int) -> np.ndarray:
        """Read an accessor as stored; a copy."""
        entry = self.gltf["accessors"][accessor]
        view = self.gltf["bufferViews"][entry["bufferView"]]
        kind = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[entry["componentType"]]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry["type"]]
        width = np.dtype(kind).itemsize * columns
        start, stride = view.get("byteOffset", 0) + entry.get("byteOffset", 0), view.get("byteStride", width)
        rows = [self.binary[start + k * stride : start + k * stride + width] for k in range(entry["count"])]
        return np.frombuffer(b"".join(rows), kind).reshape(-1, columns).copy()

    def replace(self, owner: dict[str, Any], key: str, values: np.ndarray) -> None:
        """Point a reference to an accessor to a new one with other values."""
        old = self.gltf["accessors"][owner[key]]
        self.binary += bytes(-len(self.binary) % 4)
        self.gltf["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes})
        self.binary += values.tobytes()
        kept = {name: old[name] for name in ("componentType", "type", "normalized") if name in old}
        self.gltf["accessors"].append({**kept, "bufferView": len(self.gltf["bufferViews"]) - 1, "count": len(values)})
        owner[key] = len(self.gltf["accessors"]) - 1

    def attributes(self, rng: np.random.Generator, name: str) -> dict[str, Any]:
        """Choose the attributes of a primitive that has one of a name."""
        primitives = [p for mesh in self.gltf.get("meshes", []) for p in mesh["primitives"]]
        found = [p["attributes"] for p in primitives if name in p["attributes"]]
        if not found:
            raise NotPossible
        return found[rng.integers(len(found))]

    def save(self, path: Path) -> None:
        """Write a .glb; NaN and control characters stay as they are."""
        gltf = {**self.gltf, "buffers": [{"byteLength": len(self.binary)}]}
        text = json.dumps({key: value for key, value in gltf.items() if value != []}).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + bytes(-len(self.binary) % 4)
        total = 12 + 8 + len(text) + 8 + len(binary)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, total) + chunks)


Mutation = Callable[[RigFile, np.random.Generator], None]


def reparent(file: RigFile, rng: np.random.Generator) -> None:
    """Move a joint below any node, itself and its own descendants included."""
    node, above = file.joint(rng), file.index(rng, "nodes")
    for entry in (*file.gltf["nodes"], *file.gltf.get("scenes", [])):
        for key in ("children", "nodes"):
            if node in entry.get(key, []):
                entry[key] = [child for child in entry[key] if child != node]
    if rng.random() < 0.2:
        above = node
    if rng.random() < 0.2:
        file.gltf.setdefault("scenes", [{}])[0].setdefault("nodes", []).append(node)  # a second root
    else:
        file.gltf["nodes"][above].setdefault("children", []).append(node)


def second_parent(file: RigFile, rng: np.random.Generator) -> None:
    """Make a joint a child of another node, too."""
    file.some(rng, "nodes").setdefault("children", []).append(file.joint(rng))


def joints_of_a_skin(file: RigFile, rng: np.random.Generator) -> None:
    """Drop, repeat, replace or swap joints in the list of a skin."""
    joints = file.some(rng, "skins")["joints"]
    if len(joints) < 3:
        raise NotPossible
    a, b = rng.choice(len(joints), 2, replace=False)
    kind = rng.integers(5)
    if kind == 0:
        del joints[a]
    elif kind == 1:
        joints[a] = joints[b]
    elif kind == 2:
        joints[a], joints[b] = joints[b], joints[a]
    elif kind == 3:
        joints[a] = file.index(rng, "nodes")
    else:
        joints.append(joints[a])


def skins(file: RigFile, rng: np.random.Generator) -> None:
    """Repeat a skin, give it to other meshes, or take it, its skeleton or its joints away."""
    skin, kind = file.some(rng, "skins"), rng.integers(6)
    users = [node for node in file.gltf["nodes"] if "skin" in node]
    if not users:
        raise NotPossible
    user = users[rng.integers(len(users))]
    if kind == 0:
        file.gltf["skins"].append(copy.deepcopy(skin))
        user["skin"] = len(file.gltf["skins"]) - 1
    elif kind == 1:
        file.some(rng, "nodes").update(mesh=user.get("mesh", 0), skin=user["skin"])
    elif kind == 2:
        del user["skin"]
    elif kind == 3:
        skin.pop("skeleton", None)
    elif kind == 4:
        skin["skeleton"] = [file.index(rng, "nodes"), -1, 10**6, "root", None][rng.integers(5)]
    else:
        skin["joints"] = skin["joints"][: rng.integers(3)]


def bind_matrices(file: RigFile, rng: np.random.Generator) -> None:
    """Remove, cut, zero, scale, shear or spoil inverse bind matrices."""
    skin, kind = file.some(rng, "skins"), rng.integers(8)
    if "inverseBindMatrices" not in skin:
        raise NotPossible
    if kind == 0:
        del skin["inverseBindMatrices"]
        return
    values = file.values(skin["inverseBindMatrices"])
    if not len(values):
        raise NotPossible
    row = rng.integers(len(values)) if rng.random() < 0.5 else slice(None)
    if kind == 1:
        values[row] = 0
    elif kind == 2:
        values[row, rng.integers(16)] = [np.nan, np.inf, 1e38, -1e-38][rng.integers(4)]
    elif kind == 3:
        values[row] *= np.float32([1e-20, 1e20, -1, 100][rng.integers(4)])
    elif kind == 4:
        values[row, [1, 4, 6]] += np.float32(rng.normal(size=3))
    elif kind == 5:
        values = values[: len(values) // 2]
    elif kind == 6:
        values[row] = np.eye(4).ravel()
    else:
        values[row, 3::4] = np.float32(rng.normal(size=4))
    file.replace(skin, "inverseBindMatrices", values)


def weights(file: RigFile, rng: np.random.Generator) -> None:
    """Make weights zero, negative, NaN, huge, or others than their sum allows."""
    owner = file.attributes(rng, "WEIGHTS_0")
    values = file.values(owner["WEIGHTS_0"])
    rows = rng.random(len(values)) < [0.01, 0.5, 1.0][rng.integers(3)]
    if values.dtype.kind == "f":
        factor = [0.0, -1.0, np.nan, np.inf, 1e30, 0.3, 7.0][rng.integers(7)]
        with np.errstate(invalid="ignore"):
            values[rows] *= np.float32(factor)
    else:
        values[rows] = [0, 1, np.iinfo(values.dtype).max][rng.integers(3)]
    file.replace(owner, "WEIGHTS_0", values)


def joint_indices(file: RigFile, rng: np.random.Generator) -> None:
    """Set joint indices out of range, equal, or at random; or take an attribute of the skin away."""
    owner, kind = file.attributes(rng, "JOINTS_0"), rng.integers(4)
    if kind == 0:
        del owner[["JOINTS_0", "WEIGHTS_0"][rng.integers(2)]]
        return
    values = file.values(owner["JOINTS_0"])
    rows = rng.random(len(values)) < [0.001, 0.5, 1.0][rng.integers(3)]
    values[rows] = {1: np.iinfo(values.dtype).max, 2: 0, 3: rng.integers(0, 5, (int(rows.sum()), 4))}[int(kind)]
    file.replace(owner, "JOINTS_0", values)


def node_transform(file: RigFile, rng: np.random.Generator) -> None:
    """Give a node a scale, a rotation, a translation or a matrix that exporters should not write."""
    node = file.gltf["nodes"][file.joint(rng)] if rng.random() < 0.7 else file.some(rng, "nodes")
    key = ["scale", "rotation", "translation", "matrix"][rng.integers(4)]
    bad = [0.0, -1.0, 1e6, 1e-6, 1e30, 1e300, float("nan"), float("inf")][rng.integers(8)]
    value = {
        "scale": [1.0] * 3,
        "rotation": [0.0, 0, 0, 1],
        "translation": [0.0] * 3,
        "matrix": np.eye(4).ravel().tolist(),
    }[key]
    places = rng.random(len(value)) < [0.2, 1.0][rng.integers(2)]
    value = [bad if place else number for number, place in zip(value, places, strict=True)]
    if key == "matrix" and rng.random() < 0.5:
        value = (np.eye(4) + np.pad(rng.normal(size=(3, 3)), ((0, 1), (0, 1)))).ravel().tolist()  # a shear
    if key == "matrix":
        for other in ("scale", "rotation", "translation"):
            node.pop(other, None)
    elif rng.random() < 0.9:
        node.pop("matrix", None)
    node[key] = value


def names(file: RigFile, rng: np.random.Generator) -> None:
    """Remove names, make all equal, swap sides, or write something unusual."""
    kind, nodes = rng.integers(5), file.gltf["nodes"]
    name = NAMES[rng.integers(len(NAMES))]
    if kind == 0:
        for node in nodes:
            node.pop("name", None)
    elif kind == 1:
        for node in nodes:
            node["name"] = name
    elif kind == 2:
        nodes[file.joint(rng)]["name"] = name
    elif kind == 3:
        a, b = nodes[file.joint(rng)], nodes[file.joint(rng)]
        a["name"], b["name"] = b.get("name", ""), a.get("name", "")
    else:
        for node in nodes:
            node["name"] = str(node.get("name", "")) + name


def animation(file: RigFile, rng: np.random.Generator) -> None:
    """Let channels target what does not exist, or keys have no order, no time or no value."""
    entry, kind = file.some(rng, "animations"), rng.integers(10)
    channel = entry["channels"][rng.integers(len(entry["channels"]))]
    sampler = entry["samplers"][channel["sampler"]]
    if kind == 0:
        channel["target"]["node"] = [10**6, -1, None, "Hips", file.index(rng, "nodes")][rng.integers(5)]
    elif kind == 1:
        channel["target"]["path"] = ["weights", "scale", "pointer", 3, ""][rng.integers(5)]
    elif kind == 2:
        channel["sampler"] = [10**6, -1, "x", None][rng.integers(4)]
    elif kind == 3:
        sampler["interpolation"] = ["STEP", "CUBICSPLINE", "BEZIER", 1][rng.integers(4)]
    elif kind == 4:
        file.gltf["animations"].append(copy.deepcopy(entry))
    elif kind == 5:
        entry[["channels", "samplers"][rng.integers(2)]] = [[], {}, None][rng.integers(3)]
    elif kind == 6:
        entry["name"] = NAMES[rng.integers(len(NAMES))]
    else:
        key = ["input", "output"][rng.integers(2)]
        values = file.values(sampler[key])
        spoiled = {7: values[::-1], 8: values[:0], 9: values * np.float32([np.nan, 1e30, 0, -1][rng.integers(4)])}
        file.replace(sampler, key, np.ascontiguousarray(spoiled[int(kind)], values.dtype))


def vrm_bones(file: RigFile, rng: np.random.Generator) -> None:
    """Add a list of VRM's humanoid bones with nodes that do not exist or stand for two bones."""
    bones = {bone: {"node": file.joint(rng)} for bone in ("hips", "spine", "head", "leftUpperArm", "rightUpperArm")}
    bones |= {bone: {"node": file.joint(rng)} for bone in ("leftUpperLeg", "rightUpperLeg", "leftFoot", "rightFoot")}
    bad = [10**6, -1, None, "Hips", bones["hips"]["node"]][rng.integers(5)]
    bones["leftUpperArm"] = [{"node": bad}, {}, None, bad][rng.integers(4)]
    humanoid: Any = [{"humanBones": bones}, {"humanBones": list(bones)}, {}, None][
        rng.choice(4, p=[0.7, 0.1, 0.1, 0.1])
    ]
    file.gltf.setdefault("extensions", {})["VRMC_vrm"] = {"specVersion": "1.0", "humanoid": humanoid, "meta": {}}
    file.gltf.setdefault("extensionsUsed", []).append("VRMC_vrm")


def morph_targets(file: RigFile, rng: np.random.Generator) -> None:
    """Give a primitive morph targets whose number or weights differ from others' and from its names."""
    mesh, kind = file.some(rng, "meshes"), rng.integers(4)
    primitive = mesh["primitives"][rng.integers(len(mesh["primitives"]))]
    if "POSITION" not in primitive["attributes"]:
        raise NotPossible
    if kind == 0:
        primitive["targets"] = [{"POSITION": primitive["attributes"]["POSITION"]}] * int(rng.integers(1, 4))
    elif kind == 1:
        primitive["targets"] = primitive.get("targets", [])[:-1]
    elif kind == 2:
        mesh["weights"] = [1.0] * int(rng.integers(4))
    else:
        mesh["extras"] = {"targetNames": [["a"] * 3, "abc", None, [1, 2]][rng.integers(4)]}


def extensions(file: RigFile, rng: np.random.Generator) -> None:
    """Add an extension that is not known, and extras of any type."""
    owner = file.some(rng, ["nodes", "meshes", "skins", "animations"][rng.integers(4)])
    owner["extensions"] = [{"ACME_rig": {"joint": 3}}, {"ACME_rig": None}, {}][rng.integers(3)]
    owner["extras"] = [1, "text", None, [], {"fbx": 3}][rng.integers(5)]
    file.gltf.setdefault("extensionsUsed", []).append("ACME_rig")
    if rng.random() < 0.3:
        file.gltf["extensions"] = {**file.gltf.get("extensions", {}), "VRM": [{}, {"humanoid": {}}][rng.integers(2)]}


MUTATIONS: tuple[Mutation, ...] = (
    reparent,
    second_parent,
    joints_of_a_skin,
    skins,
    bind_matrices,
    weights,
    joint_indices,
    node_transform,
    names,
    animation,
    vrm_bones,
    morph_targets,
    extensions,
)


def mutate(path: Path, output: Path, seed: int) -> list[str]:
    """Write a file with one to three mutations; returns their names."""
    rng, file, done = np.random.default_rng(seed), RigFile(path), []
    wanted = int(rng.integers(1, 4))
    while len(done) < wanted:
        mutation = MUTATIONS[rng.integers(len(MUTATIONS))]
        with contextlib.suppress(NotPossible, KeyError, IndexError, TypeError):  # of what earlier mutations removed
            mutation(file, rng)
            done.append(mutation.__name__)
    file.save(output)
    return done


class Checker:
    """Runs commands on a damaged file together with a sound one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.model = str(write_mime_network(folder / "mime.onnx"))
        person = rigs.figure()
        self.sound = rigs.character(folder / "sound.glb", clips={"move": rigs.exercise(person, 3)})

    def failures(self, damaged: Path, original: Path | None = None) -> Iterator[str]:
        """Yield what went wrong, one line for each command."""
        out, sound = self.folder / "out.glb", self.sound
        commands = [
            ["look", damaged],
            ["animate", damaged, sound, "-o", out, "-m", self.model],
            ["animate", sound, damaged, "-o", out, "-m", self.model],
            ["animate", damaged, damaged, "-o", out.with_name("copy.glb"), "-m", self.model],
            ["transfer", damaged, sound, "-o", out, "-m", self.model],
            ["transfer", sound, damaged, "-o", out.with_suffix(".gltf"), "-m", self.model],
            ["animate", damaged, sound, "-o", out, "-m", self.model, "--names", "unreal", "--root-bone"],
            ["animate", damaged, damaged, "-o", out.with_name("seen.glb"), "-m", self.model, "--preview"],
        ]
        if original is not None and original.suffix != ".fbx":
            commands.append(["animate", damaged, original, "-o", out, "-m", self.model])
        for words in commands:
            plain = words[0] == "animate" and "--preview" not in words
            command = [str(word) for word in words] + (["-q", "--no-preview"] if plain else [])
            result = self._result(command)
            if result is not None:
                yield f"{command[0]} {' '.join(Path(word).name for word in command[1:3])}: {result}"

    def _result(self, command: list[str]) -> str | None:
        """Run a command; returns what is wrong with its result."""
        output = Path(command[command.index("-o") + 1]) if "-o" in command else None
        if output is not None:
            output.unlink(missing_ok=True)
        stdout, stderr = io.StringIO(), io.StringIO()
        try:
            with (
                _alarm(),
                contextlib.redirect_stdout(stdout),
                contextlib.redirect_stderr(stderr),
                warnings.catch_warnings(record=True, action="always") as warned,
            ):
                code = run(command)
        except Hang:
            return f"more than {LONGEST_RUN} s"
        message = stderr.getvalue().strip()
        if code not in (0, 2) or message.count("\n") or (code == 2 and not message.startswith("mimesh: ")):
            return f"exit code {code}: {message}"
        if warned:
            return "; ".join(sorted({f"{Path(w.filename).name}:{w.lineno}: {w.message}" for w in warned}))
        if output is None or code == 2:
            return None
        return _unreadable(output, moving=command[0] == "animate")


def _unreadable(path: Path, moving: bool) -> str | None:
    """Read a result again, as a clip where it is `moving`; returns why that fails."""
    try:
        with _alarm():
            clip = load_clip(path) if moving else Clip.still(load_mesh(path))
    except InputError as error:
        return f"written, but not readable: {error}"
    except Hang:
        return f"written, but reading takes more than {LONGEST_RUN} s"
    finite = all(np.isfinite(vertices).all() for vertices in clip.vertices)
    return None if finite else "written with NaN"


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    """Raise Hang after LONGEST_RUN seconds."""

    def stop(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LONGEST_RUN)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def main() -> None:
    """Check variants of the files in turn, and print failures with the seed that makes them again."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--variants", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="check this variant alone, and keep its file as variant.glb")
    args = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        checker = Checker(Path(folder))
        for number in range(args.variants) if args.only is None else [args.only]:
            source = args.files[number % len(args.files)]
            damaged = (Path(folder) if args.only is None else Path()) / "variant.glb"
            done = mutate(source, damaged, args.seed + number)
            found = list(checker.failures(damaged, source))
            failed += bool(found)
            for line in found:
                print(f"variant {number} of {source.name} ({', '.join(done)}): {line}", flush=True)
    print(f"{failed} of {args.variants if args.only is None else 1} variants failed")


if __name__ == "__main__":
    main()
