"""Measure the motion of clips on characters' own rigs: between makers, where no vertex is known to be true.

Characters of a pool are written as glTF files with their joints, weights and clips, and go through the tool as a user's
files do. Results are compared with the driving by their surfaces (`limb_metrics`), whose rest directions do not come
from the joints that the tool aligns.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from character_write import write_character
from jaxtyping import Float

from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import find_limbs, name_limb_joints
from mimesh.bodies.character_pool import PoolCharacter, facing_rotation
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.options import MotionOptions
from mimesh.evaluate.limb_metrics import LimbedCharacter, PosedLimbs, limb_angles, limb_metrics
from mimesh.io import load_clip
from mimesh.io.gltf.own_rig import GltfJoints, read_own_rig
from mimesh.methods.find import find_mime
from mimesh.pipeline import animate
from mimesh.pipeline.file_rigs import Rigs
from mimesh.pipeline.joint_route import joint_route
from mimesh.pipeline.known import Known
from mimesh.pipeline.result import ClipResult, Timer

FPS = 30.0
"""Frame rate of the pool's clips."""
MEASURED_FRAMES = 6
"""Frames of a clip, evenly spread, in which surfaces are compared."""
UPRIGHT_STEP = 5
"""Frames from one to the next in which trunks are compared."""
INFLUENCES = 6
"""Largest weights of the shipped body that are measured."""
METRICS = ("limb_deg", "end_effector", "sole_height", "touching")


@dataclass(frozen=True, eq=False)
class Actor:
    """A clip, and the character that plays it."""

    name: str
    maker: str
    clip: Clip
    limbed: LimbedCharacter


def choose_characters(characters: tuple[PoolCharacter, ...], count: int) -> list[PoolCharacter]:
    """Choose characters, packs in turn, evenly spread over each pack."""
    packs: dict[str, list[PoolCharacter]] = {}
    for character in characters:
        packs.setdefault(character.meta.pack, []).append(character)
    taken = dict.fromkeys(packs, 0)
    while sum(taken.values()) < min(count, len(characters)):
        pack = min((pack for pack in packs if taken[pack] < len(packs[pack])), key=lambda pack: taken[pack])
        taken[pack] += 1
    return [packs[pack][k] for pack in packs for k in _spread(len(packs[pack]), taken[pack])]


def write_pool(characters: list[PoolCharacter], folder: Path) -> dict[str, Path]:
    """Write characters with their clips as .glb files; returns the file of each by its name."""
    paths = {character.meta.file: folder / f"{character.meta.file}.glb" for character in characters}
    for character in characters:
        write_character(character, paths[character.meta.file], character.clips, FPS)
    return paths


def pool_actor(character: PoolCharacter, path: Path, clip: str) -> Actor:
    """Return a clip of a character of the pool."""
    name = f"{character.meta.file} {clip}"
    return Actor(
        name, character.meta.maker, load_clip(path, animation=clip), LimbedCharacter(character.rig, character.limbs)
    )


def motion_actors(path: Path, maker: str, animations: list[str] | None = None) -> Iterator[Actor]:
    """Yield motions of joints without a mesh, played by the shipped body."""
    for animation in animations or [None]:
        clip = load_clip(path, animation=animation)
        yield Actor(f"{path.stem} {animation or ''}".strip(), maker, clip, body_limbs())


def body_limbs() -> LimbedCharacter:
    """Return the shipped body (mean shape) as a character whose limbs can be measured."""
    body = load_body()
    strongest = np.argsort(-body.weights, axis=1)[:, :INFLUENCES]
    weights = np.take_along_axis(body.weights, strongest, axis=1)
    frames = np.tile(np.eye(4), (len(body.parents), 1, 1))
    frames[:, :3, 3] = body.joints
    mesh = body.mesh()
    points = np.broadcast_to(mesh.vertices[:, None], (*weights.shape, 3))
    weights = weights / weights.sum(axis=1, keepdims=True)
    rig = SkinnedCharacter(mesh, body.joint_names, body.parents, frames, strongest, weights, points)
    return LimbedCharacter(rig, find_limbs(rig, name_limb_joints(rig, body.name), body.name))


def measure(result: ClipResult, limbed: LimbedCharacter, actor: Actor) -> dict[str, float | None]:
    """Compare the result with the clip that it imitates: METRICS, means over MEASURED_FRAMES, and speeds of soles.

    `upright`: cosine between the directions of both trunks, in the frame in which it is smallest of every
    UPRIGHT_STEP-th: characters are turned over for a few frames only.
    """
    turn = facing_rotation(result.report["driving"]["front"])
    frames = np.linspace(0, len(actor.clip) - 1, MEASURED_FRAMES).round().astype(int).tolist()

    def posed(t: int) -> tuple[PosedLimbs, PosedLimbs]:
        mine, theirs = (np.asarray(clip.vertices[t], float) for clip in (result.clip, actor.clip))
        return PosedLimbs(limbed, mine), PosedLimbs(actor.limbed, theirs @ turn.T)

    pairs = [posed(t) for t in frames]
    figures = [limb_metrics(mine.limbed, theirs.limbed, mine.vertices, theirs.vertices) for mine, theirs in pairs]
    measured: dict[str, float | None] = {name: _mean([figure[name] for figure in figures]) for name in METRICS}
    trunk = [limb_angles(*posed(t)).get("Trunk") for t in {*range(0, len(actor.clip), UPRIGHT_STEP), *frames}]
    measured["upright"] = min((float(np.cos(np.radians(angle))) for angle in trunk if angle is not None), default=None)
    measured["skate"], measured["skate_driving"] = (
        result.report.get(key) for key in ("foot_skate", "foot_skate_driving")
    )
    return measured


def retarget(identity: Mesh, actor: Actor) -> ClipResult:
    """Run the tool as a user does."""
    return animate(identity, actor.clip)


def copy_rotations(identity: Mesh, actor: Actor) -> ClipResult | None:
    """Give each joint the world rotation of its namesake since rest, without calibrating the rest poses.

    That is what constraints of the kind "copy rotation" do that are set up by hand, joint by joint. None for clips
    whose joints are not in a file with a mesh: their rest pose is not known.
    """
    skeleton = actor.clip.skeleton
    if not isinstance(skeleton, GltfJoints) or skeleton.mesh is None:
        return None
    own, theirs = read_own_rig(identity), read_own_rig(skeleton.mesh)
    person = skeleton.person()
    undone = np.stack([theirs.humanoid.frames[name].T @ theirs.humanoid.turn.T for name in person.joints])
    rest = {name: own.humanoid.turn.T for name in own.humanoid.frames}
    rigs = Rigs(
        dataclasses.replace(own, humanoid=dataclasses.replace(own.humanoid, frames=rest)),
        dataclasses.replace(person, rotation=person.rotation @ undone),
    )
    route = joint_route(identity, actor.clip, find_mime("mime"), Known(), rigs)
    moved = route.play(Timer(), MotionOptions(ground=False, contacts=False))
    return ClipResult(identity, moved.frames, actor.clip.fps, "copy rotations", Timer(), moved.report, moved.notes)


def _spread(available: int, count: int) -> list[int]:
    return np.linspace(0, available - 1, count).round().astype(int).tolist() if count else []


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def summary(values: list[float]) -> dict[str, float]:
    """Summarise figures: mean, median and 90th percentile."""
    array: Float[np.ndarray, " N"] = np.array(values)
    return {"mean": float(array.mean()), "median": float(np.median(array)), "p90": float(np.percentile(array, 90))}
