"""Save results as one skinned file: joints, weights, and an animation for each result."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..bodies.character_limbs import SIDES
from ..bodies.engine_names import SCHEMES, root_name
from ..bodies.engine_rig import engine_rig
from ..bodies.joint_names import finger_joints
from ..core.animated_rig import CHECKED_FRAMES, AnimatedRig, RigAnimation
from ..core.arguments import described, public
from ..core.errors import InputError, option
from ..core.frame_buffer import evenly_spread
from ..core.options import Layout, needs_joints
from ..core.printable import file_name, numbered
from ..core.rig import Rig, descendants
from ..io import joints_file
from ..io.gltf.animation import animation_names
from ..io.gltf.own_animation import laid_out, write_own_animations
from ..io.gltf.skinned import write_gltf_skinned
from .report import Deviations, SavedClip, saved_clip
from .vrm import save_bone_motions

if TYPE_CHECKING:
    from .result import ClipResult

AS_IT_IS = Layout()
"""Bones as the rig has them."""
SAME_JOINT = 1e-4
"""Largest distance, over the mesh's size, between joints or vertices of two results that count as the same."""


@public
def save_skinned(
    results: Sequence[ClipResult],
    path: str | Path,
    *,
    animations: Sequence[str] | None = None,
    layout: Layout = AS_IT_IS,
) -> SavedClip:
    """Write results of one identity as one .glb, .gltf or .vrma: its mesh at rest with joints, an animation for each.

    An identity that moved on its own bones keeps its file, to which the animations are added. Otherwise joints have as
    many weights a vertex as `MotionOptions.influences` says. A .vrma has the motion alone: the humanoid bones of VRM in
    a T-pose, their rotations and the path of the hips.

    Args:
        results: of `animate` with one identity and the same options of the identity. Fingers that only some of them
            move follow the hand in the others.
        path: the file to write.
        animations: names of the animations; by default those of the driving clips. Equal ones get a number.
        layout: names and arrangement of the bones.

    Returns:
        The path, and how far a file with a mesh is from the frames of each result.

    Raises:
        InputError: a model without joints, several identities, results of which only some are on the identity's own
            rig, another format, or a path that cannot be written to.

    Example:
        >>> saved = mimesh.save_skinned([moving, moving], "hero-moves.glb", animations=["walk", "again"])
    """
    _check_results(results, path, animations)
    if not isinstance(layout, Layout):
        raise InputError(f'layout: expected a Layout, found {described(layout)}; give mimesh.Layout("unreal")')
    found = animations or [(result if result.driving is None else result.driving).mesh.name for result in results]
    own = any(result.own is not None for result in results)
    if own:
        _check_same_rig(results, found)
    names = free_names(results, found, Path(path))
    if Path(path).suffix.lower() == ".vrma":
        save_bone_motions(results, Path(path), names, layout)
        return saved_clip(path, *(Deviations() for _ in results))
    save = _save_on_own_rig if own else _save_on_found_rig
    return saved_clip(path, *save(results, Path(path), names, layout))


def _save_on_found_rig(
    results: Sequence[ClipResult], path: Path, names: Sequence[str], layout: Layout
) -> Iterator[Deviations]:
    """Write the joints that were found on a surface, with an animation for each result; yield its deviations."""
    skeletons = []
    for result in results:
        if result.skeleton is None:
            raise needs_joints("skinned", result.model)
        skeletons.append(result.skeleton)
    with results[0].seconds.step("write"):
        facing = results[0].report["identity"]
        common = on_common_rig(skeletons)
        moved = [
            engine_rig(skeleton, layout.names, layout.root_bone, layout.rest, up=facing["up"], front=facing["front"])
            for skeleton in common
        ]
        motions = [
            RigAnimation(name, skeleton, result.fps).resampled(layout.fps)
            for name, skeleton, result in zip(names, moved, results, strict=True)
        ]
        with joints_file(path) as temporary:
            write_gltf_skinned(motions, temporary)
    for result, skeleton, own, shared in zip(results, moved, skeletons, common, strict=True):
        cause = "rest" if layout.rest != "file" else "weights" if shared.names == own.names else "fingers"
        yield {"skinned_deviation": skeleton.deviation(result.frames), "deviation_cause": cause}


def _check_results(results: Sequence[ClipResult], path: str | Path, names: Sequence[str] | None) -> None:
    if not isinstance(results, Sequence) or isinstance(results, str):
        raise InputError(f"results: expected a list of results of animate, found {described(results)}; give [result]")
    if not results:
        raise InputError(f"{path}: expected results of animate to save, found none")
    for result in results:
        if not hasattr(result, "frames"):
            raise InputError(f"results: expected those of animate, found {described(result)}; give ClipResult objects")
    if names is not None and (isinstance(names, str) or len(names) != len(results)):
        found = described(names) if isinstance(names, str) else len(names)
        raise InputError(f"{path}: expected a name for each of {len(results)} results, found {found}")


def check_own_layout(person: Mapping[str, int], layout: Layout, name: str) -> None:
    """Check that the own rig of an identity can get a layout, before anything moves it.

    Args:
        person: node of each joint that is known to be a person's, by our name.

    Raises:
        InputError: another rest pose than the file's, or names and a root bone for what is no person.
    """
    if layout.rest != "file":
        raise InputError(
            f"{option('rest')}: expected `{option('rest', 'file')}` for {name}, whose own rig stays as it is bound, "
            f"found {layout.rest}; "
            f"set the pose in the engine (its retarget pose), or give up the rig with {option('rig', 'mimesh')}"
        )
    if (SCHEMES[layout.names].bones or root_name(layout) is not None) and "Hips" not in person:
        raise InputError(
            f"{option('names')}, {option('root_bone')}: expected the bones of a person in {name}, found others; "
            "leave the options out"
        )


def _check_same_rig(results: Sequence[ClipResult], names: Sequence[str]) -> None:
    moved = {result.own is not None: name for result, name in zip(results, names, strict=True)}
    if False in moved:
        raise InputError(
            f"{moved[False]}: expected a motion of the identity's own bones, as that of {moved[True]}, found one of "
            f"joints on its surface; write a file for each of the two, or choose {option('rig', 'mimesh')} for all"
        )
    first, *others = [result.own.source.document for result in results if result.own is not None]
    for name, document in zip(names[1:], others, strict=True):
        same = first.gltf == document.gltf and bytes(first.binary) == bytes(document.binary)
        if first is not document and not same:
            raise InputError(
                f"{name}: expected results of one identity, found {first.path} and {document.path}; "
                "write a file for each identity"
            )


def _save_on_own_rig(
    results: Sequence[ClipResult], path: Path, names: Sequence[str], layout: Layout
) -> Iterator[Deviations]:
    """Write the identity's own file with new animations of its bones; yield the deviations of each."""
    animations = []
    for name, result in zip(names, results, strict=True):
        assert result.own is not None
        check_own_layout(result.own.joints, layout, result.own.source.document.path.name)
        own = laid_out(dataclasses.replace(result.own, name=name), layout)
        animations.append(own if layout.fps is None else own.resampled(layout.fps))
    with results[0].seconds.step("write"), joints_file(path) as temporary:
        write_own_animations(animations, temporary)
    for result in results:
        yield {"skinned_deviation": _own_deviation(result)}


def _own_deviation(result: ClipResult) -> float:
    """Measure how far vertices of an animation of nodes are from its result at most, over the mesh's size."""
    own, chosen = result.own, evenly_spread(len(result.frames), CHECKED_FRAMES)
    assert own is not None
    pairs = zip(own.vertices(chosen), result.frames.at(chosen), strict=True)
    distance = max(np.linalg.norm(posed - vertices, axis=1).max() for posed, vertices in pairs)
    return float(distance / np.ptp(own.source.vertices, axis=0).max())


def free_names(results: Sequence[ClipResult], names: Sequence[str], path: Path) -> list[str]:
    """Number names that were there before, or are those of animations that a file keeps of the identity's own."""
    own = results[0].own
    taken = () if own is None or path.suffix.lower() == ".vrma" else animation_names(own.source.document)
    return distinct_names([*taken, *names])[len(taken) :]


def distinct_names(names: Sequence[str]) -> list[str]:
    """Number names that were there before, as files are named on any system: walk, walk-2, Walk-3."""
    distinct: dict[str, str] = {}
    for name in names:
        free = next(other for other in numbered(name) if file_name(other).casefold() not in distinct)
        distinct[file_name(free).casefold()] = free
    return list(distinct.values())


def on_common_rig(skeletons: Sequence[AnimatedRig]) -> list[AnimatedRig]:
    """Give motions of one identity the same joints, rest pose and weights; the vertices move as before.

    Only fingers may differ: a model that finds them adds their joints where the driving moves them. The common rig has
    the fingers that any motion has; in the others these follow the hand.
    """
    first = skeletons[0]
    for skeleton in skeletons[1:]:
        _check_same(first, skeleton)
    if all(skeleton.names == first.names for skeleton in skeletons):
        names, parents, rig = first.names, first.parents, first.rig
    else:
        names, parents, rig = _with_all_fingers(skeletons)
    influences = max(skeleton.influences for skeleton in skeletons)
    moved = [_moved_onto(skeleton, names, parents, rig) for skeleton in skeletons]
    return [dataclasses.replace(skeleton, influences=influences) for skeleton in moved]


def _body_names(skeleton: AnimatedRig) -> list[str]:
    fingers = {name for side in SIDES for name in finger_joints(side)}
    return [name for name in skeleton.names if name not in fingers]


def _check_same(first: AnimatedRig, other: AnimatedRig) -> None:
    a, b = first.mesh.vertices, other.mesh.vertices
    allowed = SAME_JOINT * first.size
    same = a.shape == b.shape and np.abs(a - b).max() <= allowed
    same = same and (first.names == other.names or _body_names(first) == _body_names(other))
    if same:
        index = {name: j for j, name in enumerate(other.names)}
        shared = [(j, index[name]) for j, name in enumerate(first.names) if name in index]
        mine, theirs = np.transpose(shared)
        same = np.abs(first.rig.joints[mine] - other.rig.joints[theirs]).max() <= allowed
    if not same:
        raise InputError(
            f"{other.mesh.name}: expected results of one identity with the same joints, found others; "
            "animate all clips with the same identity and options"
        )


def _with_all_fingers(skeletons: Sequence[AnimatedRig]) -> tuple[tuple[str, ...], tuple[int, ...], Rig]:
    """Return names, parents and rig with the body's joints of the first motion and the fingers of all of them."""
    body = _body_names(skeletons[0])
    sources = [(name, skeletons[0]) for name in body]
    fingered: dict[str, AnimatedRig] = {}
    for side in SIDES:
        owner = next((skeleton for skeleton in skeletons if finger_joints(side)[0] in skeleton.names), None)
        if owner is not None:
            fingered[side] = owner
            sources += [(name, owner) for name in finger_joints(side)]
    names = tuple(name for name, _ in sources)
    rotation, joints, parents = [], [], []
    for name, owner in sources:
        j = owner.names.index(name)
        rotation.append(owner.rig.rotation[j])
        joints.append(owner.rig.joints[j])
        parents.append(-1 if owner.parents[j] < 0 else names.index(owner.names[owner.parents[j]]))
    weights = _spread_weights(skeletons[0], names)
    # Fingers take weights from the hand's other joints: all vertices of a hand have the weights of its fingers' owner.
    for side, owner in fingered.items():
        spread = _spread_weights(owner, names)
        hand = descendants([names.index(f"{side}Hand")], tuple(parents))
        of_hand = spread[:, hand].any(axis=1) | weights[:, hand].any(axis=1)
        weights[of_hand] = spread[of_hand]
    return names, tuple(parents), Rig(np.stack(rotation), np.stack(joints), weights)


def _spread_weights(skeleton: AnimatedRig, names: tuple[str, ...]) -> np.ndarray:
    """Return a motion's weights with a column for each of the names, which include its joints."""
    weights = np.zeros((len(skeleton.rig.weights), len(names)))
    weights[:, [names.index(name) for name in skeleton.names]] = skeleton.rig.weights
    return weights


def _moved_onto(skeleton: AnimatedRig, names: tuple[str, ...], parents: tuple[int, ...], rig: Rig) -> AnimatedRig:
    """Return a motion on another rig of its identity: joints rotate as far from rest; new ones follow their parent."""
    index = {name: j for j, name in enumerate(skeleton.names)}
    since_rest = skeleton.rotation @ skeleton.rig.rotation.swapaxes(-1, -2)
    moved: list[np.ndarray] = []
    for j, name in enumerate(names):
        moved.append(since_rest[:, index[name]] if name in index else moved[parents[j]])
    rotation = np.stack(moved, axis=1) @ rig.rotation
    return dataclasses.replace(skeleton, names=names, parents=parents, rig=rig, rotation=rotation)
