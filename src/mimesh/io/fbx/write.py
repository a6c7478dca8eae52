"""Write FBX files: a temporary .glb is exported by Blender, which runs `blender_export.py` as a process of its own.

Blender's exporter writes a take for each strip of time of one object. So the animations become one long animation,
sampled in every frame, of which each is a strip; and everything that moves becomes a bone of one armature.

Blender's importer builds a network of nodes where vertex colours, a texture or a factor are multiplied, or where a
material is unlit. Its exporter writes neither: such a colour becomes 0.8 grey. So the script that Blender runs gets
colour, opacity and image of each material from here. Blender cuts and numbers names, so that materials and images get
unique short ones for the import.

Blender is under the GNU General Public License. Nothing of it is part of mimesh or loaded into its process: both
exchange files. The script that Blender runs uses Blender's Python interface, so it must have a licence compatible with
the GPL 3; that of mimesh (Apache 2.0) is, and the script needs no other.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ...bodies.joint_names import ancestors
from ...core.errors import InputError, NotInstalledError
from ...core.printable import file_name, numbered
from ..atomic import scratch_folder
from ..child_process import MIB, last_line
from ..gltf.animation import AnimationChannel, add_animation, animation_names, frame_rate, frame_times, read_channels
from ..gltf.document import Document, open_document, uri_file_name
from ..gltf.draft import AccessorCopier, Draft
from ..gltf.own_animation import node_value
from ..gltf.read import base_color_of, base_texture_of
from ..gltf.scene import local_matrices, node_parents, read_inverse_bind_matrices, world_matrices
from ..mtl import image_type
from ..timing import DEFAULT_FPS

SCRIPT = Path(__file__).with_name("blender_export.py")
VARIABLE = "BLENDER"
"""Environment variable that names the program, or a Python interpreter that has `bpy`."""
PACKAGE = "bpy==4.5.15"
"""Blender as a package, in the version that was tested; its wheels are for Python 3.11."""
SECONDS, SECONDS_PER_MIB = 300.0, 30.0
"""Longest run: starting Blender takes 2 to 5 s, a character of 13,000 vertices with 300 frames (1 MiB) 4 s."""
GAP = 2
"""Frames between two animations, so that none begins where another ends."""
SHORTEST = 2
"""Frames of a pose: a strip of time needs an end after its beginning."""
SAME_UNIT = 1e-2
"""Share by which the unit that a skin is bound in may differ from that of the node above its joints."""
MATERIAL, IMAGE = "mimesh-material-{}", "mimesh-image-{}"
"""Names of materials and images during the import; Blender keeps up to 63 bytes."""
SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpg", "image/webp": ".webp", "image/ktx2": ".ktx2"}
LONGEST = 40
"""Characters of an image's name without its suffix."""


def find_blender(path: Path) -> list[str]:
    """Return the command that runs a Python script in Blender; the script's path is to be added.

    $BLENDER comes first, then the package `bpy` of this Python, then the program on the search path.

    Raises:
        InputError: there is none, so that `path` cannot be written.
    """
    named = os.environ.get(VARIABLE)
    if named:
        program = shutil.which(named)
        if program is None:
            raise InputError(f"{path}: expected Blender at {VARIABLE}={named}, found no program there; correct it")
        return _as_python(program) if Path(program).stem.lower().startswith("python") else _as_program(program)
    if importlib.util.find_spec("bpy") is not None:
        return _as_python(sys.executable)
    program = shutil.which("blender")
    if program is None:
        raise NotInstalledError(
            f"{path}: expected Blender to write FBX, found none; pip install {PACKAGE} (in Python 3.11), or install "
            f"the program and name it in {VARIABLE}, or write a .glb"
        )
    return _as_program(program)


def _as_program(program: str) -> list[str]:
    return [program, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]


def _as_python(python: str) -> list[str]:
    # Without -P, modules beside the script could be imported in place of others of their names.
    return [python, "-P", "-X", "utf8"]


def write_fbx(glb: Path, target: Path, name: Path) -> None:
    """Export a .glb as .fbx: y up, in centimetres, one take for each animation, with embedded textures.

    Args:
        name: the file that error messages name.
    """
    command = find_blender(name)
    document = open_document(glb)
    draft, timeline = joined_animations(document)
    _place_skeletons(draft, document)
    surfaces = _plain_materials(draft, document)
    with scratch_folder() as folder:
        scene, job = folder / "scene.glb", folder / "job.json"
        draft.save(scene)
        # The folder of embedded images is named after the file.
        written = folder / name.with_suffix(".fbx").name
        files = {"glb": str(scene), "fbx": str(written), "errors": str(folder / "errors")}
        Path(files["errors"]).touch()
        job.write_text(json.dumps(files | timeline | surfaces), encoding="utf-8", newline="\n")
        seconds = SECONDS + SECONDS_PER_MIB * scene.stat().st_size / MIB
        code = _run([*command, str(SCRIPT), "--", str(job)], folder, seconds, name)
        if code or not written.is_file():
            message = last_line(Path(files["errors"])) or last_line(folder / "output") or f"exit code {code}"
            raise InputError(
                f"{name}: expected Blender ({command[0]}) to write FBX, found '{message[:300]}'; "
                "try another version of Blender, or write a .glb"
            )
        shutil.copyfile(written, target)


def _run(command: list[str], folder: Path, seconds: float, name: Path) -> int:
    """Run Blender in a folder without the user's settings and add-ons, and return its exit code."""
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user")}
    try:
        with Path(folder, "output").open("wb") as output:  # Blender does not outlive this call, also on Ctrl-C
            run = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=folder,
                timeout=seconds,
                check=False,
            )
    except OSError as error:
        raise InputError(f"{name}: expected Blender at {command[0]}, found '{error.strerror}'; correct it") from error
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"{name}: expected Blender to write it in {seconds:.0f} s, found it still running; write a .glb"
        ) from error
    return run.returncode


def joined_animations(document: Document) -> tuple[Draft, dict[str, Any]]:
    """Return the file with its animations joined, and where in time each of them is.

    All are sampled at the frame rate of the first. What an animation leaves out has the value of the node.

    Returns:
        The file; "fps" and "clips", each with "name", and the frames "first" and "last"; frame 0 is the file at rest.
    """
    names = animation_names(document)
    channels = [[c for c in read_channels(document, number) if len(c.times)] for number in range(len(names))]
    rates = (frame_rate(of_one) for of_one in channels)
    fps = next((rate for rate in rates if rate is not None), DEFAULT_FPS)
    draft = AccessorCopier(document, whole=True).draft
    # The first frame is the pose in which the nodes are, so that the exporter writes them as they are.
    clips, times, samples = [], [np.zeros(1)], [(1, {})]
    first = GAP
    for name, of_one in zip(names, channels, strict=True):
        if not of_one:
            continue
        taken = frame_times(document, of_one, fps)
        taken = np.resize(taken, SHORTEST) * 0 if len(taken) < SHORTEST else taken
        clips.append({"name": name, "first": first, "last": first + len(taken) - 1})
        times.append((first + np.arange(len(taken))) / fps)
        samples.append((len(taken), {(c.node, c.path): c.sample(taken) for c in of_one}))
        first += len(taken) - 1 + GAP
    draft.gltf["animations"] = []
    moving: set[int] = set()
    if clips:
        moved = dict.fromkeys(key for _, values in samples for key in values)
        still = {key: node_value(document.gltf["nodes"][key[0]], key, document) for key in moved}
        joined = []
        for key in moved:
            values = np.concatenate([of_one.get(key, np.repeat(still[key], count, 0)) for count, of_one in samples])
            joined.append(AnimationChannel(key[0], key[1], np.concatenate(times), values))
        draft.gltf["animations"] = [add_animation(draft, "all", joined)]
        moving |= {node for node, path in moved if path != "weights"}
    # Nodes below joints that show nothing are bones, too, which move no vertex, or places for props.
    nodes, parents = document.gltf.get("nodes", []), node_parents(document)
    joints = {joint for skin in document.gltf.get("skins", []) for joint in skin["joints"]}
    bare = [k for k, node in enumerate(nodes) if not {"mesh", "camera", "extensions"} & node.keys()]
    _make_joints(draft, document, moving | {node for node in bare if joints.intersection(ancestors(parents, node))})
    return draft, {"fps": fps, "clips": clips}


def _make_joints(draft: Draft, document: Document, bones: set[int]) -> None:
    """Add a skin that no mesh uses, of the nodes that move or are below joints, and of a joint of each other skin.

    Blender makes the joints of a skin, and what is between them, bones of the armature at their common ancestor.
    """
    skins = draft.gltf.get("skins", [])
    extra = sorted(bones - {joint for skin in skins for joint in skin["joints"]})
    if not extra and len(skins) < 2:
        return
    inverse_bind: dict[int, np.ndarray] = {}
    for number, skin in enumerate(skins):
        inverse_bind |= dict(zip(skin["joints"], read_inverse_bind_matrices(document, number), strict=True))
    world = world_matrices(document)
    parents = node_parents(document)
    chains = {joint: ancestors(parents, joint) for joint in sorted(inverse_bind)}
    for node in extra:
        # The nearest joint above it, or else below it, or else any; None where there are no joints.
        above = next((other for other in ancestors(parents, node) if other in chains), None)
        below = min((joint for joint in chains if node in chains[joint]), key=lambda j: len(chains[j]), default=None)
        joint = next((joint for joint in (above, below, *chains) if joint is not None), None)
        # Skins may be bound in another space than the world: the node is placed as it is beside a joint.
        placed = np.eye(4) if joint is None else world[joint] @ inverse_bind[joint]
        inverse_bind[node] = np.linalg.pinv(world[node]) @ placed
    joints = sorted(inverse_bind)
    inverse = draft.add_matrices(np.stack([inverse_bind[joint] for joint in joints]))
    skin = {"name": "Armature", "joints": joints, "inverseBindMatrices": inverse}
    draft.gltf["skins"] = [*skins, skin]


def _place_skeletons(draft: Draft, document: Document) -> None:
    """Remove the skeleton that a skin names, where the skin is not bound in the unit of the node above its joints.

    Blender places the topmost joints of such a skeleton by their inverse bind matrices. Files with quantized positions
    are bound in units of thousands: bones that far away lose their length in single precision, and are removed.
    """
    local, parents = local_matrices(document), node_parents(document)
    for number, skin in enumerate(document.gltf.get("skins", [])):
        bound = np.linalg.det(read_inverse_bind_matrices(document, number)[:, :3, :3])
        for joint, volume in zip(skin["joints"], bound, strict=True):
            topmost = parents[joint] not in skin["joints"]
            if topmost and abs(np.cbrt(volume * np.linalg.det(local[joint][:3, :3])) - 1) > SAME_UNIT:
                draft.gltf["skins"][number].pop("skeleton", None)


def _without_textures(entry: Any, missing: set[int]) -> Any:
    """Return a material, or an entry of one, without its references to some textures."""
    if not isinstance(entry, dict):
        return entry
    return {
        key: _without_textures(value, missing)
        for key, value in entry.items()
        if not (key.endswith("Texture") and isinstance(value, dict) and value.get("index") in missing)
    }


def _plain_materials(draft: Draft, document: Document) -> dict[str, list[dict[str, Any]]]:
    """Rename the materials and images of a draft, and list what the script is to make of each.

    Textures without an image are left out: Blender's importer fails at some of them.
    """
    missing = {
        number
        for number, texture in enumerate(draft.gltf.get("textures", []))
        if not any(document.images[image] for image in _images_of(texture, document))
    }
    if "materials" in draft.gltf:
        draft.gltf["materials"] = [_without_textures(entry, missing) for entry in draft.gltf["materials"]]
    images = [{"key": IMAGE.format(number), "name": name} for number, name in enumerate(_image_names(document))]
    materials = []
    for number, entry in enumerate(draft.gltf.get("materials", [])):
        *color, alpha = base_color_of(entry)
        reference, source = base_texture_of(entry), None
        if "index" in reference:
            source = next(iter(_images_of(draft.gltf["textures"][reference["index"]], document)), None)
        materials.append(
            {
                "key": MATERIAL.format(number),
                "name": entry.get("name") or f"material{number}",
                "color": color,
                "alpha": alpha if entry.get("alphaMode", "OPAQUE") == "BLEND" else 1.0,
                "image": None if source is None else images[source]["key"],
            }
        )
        entry["name"] = materials[-1]["key"]
    for entry, image in zip(draft.gltf.get("images", []), images, strict=True):
        entry["name"] = image["key"]
    return {"materials": materials, "images": images}


def _images_of(texture: dict[str, Any], document: Document) -> list[int]:
    """List the images of a texture: the plain one, and those of extensions."""
    others = [other for other in texture.get("extensions", {}).values() if isinstance(other, dict)]
    named = [each.get("source") for each in (texture, *others)]
    return [image for image in named if isinstance(image, int) and 0 <= image < len(document.images)]


def _image_names(document: Document) -> list[str]:
    """List unique file names of all images, with the suffix of their format."""
    names: list[str] = []
    for number, (image, content) in enumerate(zip(document.gltf.get("images", []), document.images, strict=True)):
        file = uri_file_name(image)
        stem = PurePosixPath(image.get("name") or file).name
        suffix = SUFFIXES.get(image_type(content) or "", "") if content else PurePosixPath(file).suffix
        while PurePosixPath(stem).suffix.lower() in {*SUFFIXES.values(), ".jpeg", ".tga", ".bmp", ".tif", ".tiff"}:
            stem = PurePosixPath(stem).stem
        stem = file_name(stem).strip(" .")[:LONGEST]
        taken = {name.lower() for name in names}  # on some systems case does not count
        names.append(next(n for n in numbered(stem or f"image{number}", suffix=suffix) if n.lower() not in taken))
    return names
