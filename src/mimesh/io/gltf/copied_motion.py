"""Copies animations between files by name: those of joints to the same skeleton, those of morph targets to any file.

Nodes of a skeleton are matched by name, and values are taken as they are. Any kind of character will do, because
nothing has to be known about its joints. Rest poses are compared in the frames of the joints' parents, as the inverse
bind matrices have them.

Names of morph targets, such as the 52 of ARKit, are in `extras.targetNames` of a mesh, a convention of most tools.
Equal names count before other spellings of the same words: browInnerUp, BrowInnerUp, brow_inner_up; mouthSmileLeft,
mouthSmile_L. Expressions of VRM are names too: a VRM identity has them as sums of its targets' weights, and a VRM
animation (.vrma) animates them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...bodies.joint_names import ancestors
from ...core.errors import InputError
from ...core.geometry import continuous_quaternions, nearest_rotation
from . import scene
from .animation import AnimatedValues, AnimationChannel, animated_nodes, sample_joints
from .document import Document
from .edit import GltfSource
from .motion import PLAYED_PATHS, rest_matrices
from .own_rig import GltfJoints, node_tracks
from .read import unweighted_parts
from .vrm import OVERRIDDEN, Expression, animated_expressions, vrm_expressions

SAME_ROTATION, SAME_BONE = 0.01, 0.002
"""Largest differences of rest poses that count as the same: of the joints' axes, and of bones in lengths of the
longest bone."""
ALIKE = 0.5
"""Largest difference of the joints' axes at rest with which rotations since rest can be copied: about 30 degrees."""
BINARY = 0.5
"""Weight above which an expression without intermediate values is full (VRM 1.0, expressions.md)."""
NEGLIGIBLE = 1e-5
"""Weight of an expression that counts as none: frames are not exactly at the times of keys, which are float32."""
_PREFIX = re.compile(r"^blendshapes?\d*\.", re.IGNORECASE)
"""Name of Maya's node before that of the target."""
_SIDE = re.compile(r"(?:[_. -]([lrLR])|(?<=[a-z])([LR]))$")
_LETTERS = re.compile(r"[^a-z0-9]")


@dataclass(frozen=True, eq=False)
class SharedMotion:
    """An animation copied from a file with the same skeleton."""

    tracks: AnimatedValues
    same_rest: bool
    """Whether both skeletons have the same rest pose and size, so that the copy is exact."""
    alike: bool
    """Whether the rest poses are alike enough for the copy of the whole skeleton."""


@dataclass(frozen=True, eq=False)
class NamedWeights:
    """Weights of a morph target or an expression of a driving file, in every frame."""

    name: str
    owner: str | None
    """Name of the node that shows the mesh; None for an expression."""
    values: Float[np.ndarray, " T"]


def copy_motion(identity: GltfSource, driving: GltfJoints) -> SharedMotion | None:
    """Copy the animation of a driving clip to the nodes of another file; None if that has another skeleton."""
    from scipy.spatial.transform import Rotation

    mine, theirs = identity.document, driving.document
    try:
        unweighted_parts(mine, identity.rest)
    except InputError:
        return None
    # Of a file without skins, joints are the nodes that animations move.
    in_skins = {node for skin in mine.gltf.get("skins", []) for node in skin["joints"]}
    joints = sorted(in_skins or animated_nodes(mine, PLAYED_PATHS))
    pairs = _pairs(mine, theirs, joints)
    if len(pairs) < max(len(joints), 2):
        return None
    my_rest, their_rest = (
        _parent_frames(document, pairs_of)
        for document, pairs_of in ((mine, list(pairs)), (theirs, list(pairs.values())))
    )
    my_axes, their_axes = (
        rest[:, :3, :3] / np.maximum(np.linalg.norm(rest[:, :3, :3], axis=1, keepdims=True), 1e-12)
        for rest in (my_rest, their_rest)
    )
    turned = np.abs(my_axes - their_axes).max(axis=(1, 2), initial=0)
    lengths = [np.linalg.norm(rest[:, :3, 3], axis=1) for rest in (my_rest, their_rest)]
    longest = max(lengths[0].max(initial=0), 1e-12)
    moved = np.abs(my_rest[:, :3, 3] - their_rest[:, :3, 3]).max(initial=0) / longest
    above_same = _same_above(mine, theirs, pairs)
    alike = bool(above_same and (turned < ALIKE).all())
    same_rest = bool(alike and moved < SAME_BONE and (turned < SAME_ROTATION).all())
    scale = 1.0 if same_rest else float(lengths[0].sum() / max(lengths[1].sum(), 1e-12))
    values = driving.values()
    tracks: AnimatedValues = {}
    for k, (node, other) in enumerate(pairs.items()):
        if turned[k] >= ALIKE:
            continue
        own, static = (
            scene.node_properties(document.gltf["nodes"][n]) for document, n in ((mine, node), (theirs, other))
        )
        for path in ("translation", "rotation", "scale"):
            value = values.get((other, path), np.array(static[path], float)[None])
            if path == "translation" and not same_rest:
                value = my_rest[k, :3, 3] + scale * (value - their_rest[k, :3, 3])
            if path == "rotation" and not same_rest:
                # Turned from its own rest pose as far as the driving's joint is turned from its one.
                mine_at, theirs_at = (
                    Rotation.from_matrix(nearest_rotation(rest[k, :3, :3])) for rest in (my_rest, their_rest)
                )
                since_rest = mine_at * theirs_at.inv() * Rotation.from_quat(value)
                value = scene.normalized_quaternions(since_rest.as_quat())
            if path == "rotation":
                value = continuous_quaternions(value, own[path])
            if len(value) > 1 and np.ptp(value, axis=0).max() == 0:
                value = value[:1]
            if len(value) > 1 or np.abs(value - own[path]).max() > 0:
                tracks[node, path] = np.broadcast_to(value, (len(driving.times), value.shape[1]))
    beside = _other_sources(mine, theirs, values, pairs)
    above = _moving_above(driving, pairs)
    # Whether all moving nodes above the joints are copied to nodes above the same joints of mine.
    parents, target = scene.node_parents(mine), {other: node for (node, _), (other, _) in beside.items()}
    has_above = all(target.get(moved) in ancestors(parents, top) for moved, tops in above.items() for top in tops)
    if above and not (same_rest and has_above):
        # The topmost joints take the motion of nodes above them that the identity lacks, or has under other names.
        beside = {key: source for key, source in beside.items() if source[0] not in above}
        for top in set().union(*above.values()):
            carried = _carried(mine, top, tracks, driving, pairs[top], scale)
            tracks = {key: track for key, track in tracks.items() if key[0] != top} | carried
    for key, source in beside.items():
        tracks[key] = continuous_quaternions(values[source]) if key[1] == "rotation" else values[source]
    # In a copy of the same file all targets have been copied already, those that do not move included.
    same_file = _names(mine) == _names(theirs) and all(
        _same_targets(mine, node, theirs, node) for node in range(len(_names(mine))) if scene.target_count(mine, node)
    )
    faces = {} if same_file else morph_tracks(mine, named_weights(theirs, driving.channels, driving.times))
    return SharedMotion(faces | tracks, same_rest, alike)


def _moving_above(driving: GltfJoints, pairs: dict[int, int]) -> dict[int, set[int]]:
    """Find the moving nodes above the paired joints of the driving, each with the topmost joints of mine below it."""
    parents, paired = scene.node_parents(driving.document), set(pairs.values())
    moving = {
        channel.node for channel in driving.channels if channel.path in scene.DEFAULT_TRS and not channel.constant
    }
    found: dict[int, set[int]] = {}
    for node, other in pairs.items():
        above = ancestors(parents, other)[1:]
        for moved in () if paired.intersection(above) else moving.intersection(above):
            found.setdefault(moved, set()).add(node)
    return found


def _carried(
    mine: Document, node: int, tracks: AnimatedValues, driving: GltfJoints, other: int, scale: float
) -> AnimatedValues:
    """Compute the values of a joint with tracks whose parent stays, so that it moves as if it had the driving's.

    That one, the node above the driving's joint, moves in its own frame at rest; its steps are scaled.
    """
    above = scene.node_parents(driving.document)[other]
    moved = sample_joints(driving.document, driving.channels, driving.times, [above])[:, 0]
    moved = np.linalg.inv(scene.world_matrices(driving.document)[above]) @ moved
    moved[:, :3, 3] *= scale
    own = scene.node_properties(mine.gltf["nodes"][node])
    local = moved @ scene.local_matrix({**own, **{path: tracks[node, path] for path in own if (node, path) in tracks}})
    return {(node, path): values for path, values in node_tracks(own, local, 0.0, 0.0).items()}


def copy_morphs(identity: GltfSource, driving: GltfJoints) -> SharedMotion | None:
    """Copy an animation of nothing but morph targets and expressions; None for others, and without common names."""
    expressions = set(animated_expressions(driving.document).values())
    if not all(channel.path == "weights" or channel.node in expressions for channel in driving.channels):
        return None
    tracks = morph_tracks(identity.document, named_weights(driving.document, driving.channels, driving.times))
    return SharedMotion(tracks, True, True) if tracks else None


def _pairs(mine: Document, theirs: Document, joints: list[int]) -> dict[int, int]:
    """Match joints to nodes of another file with the same name below joints with the same names.

    Of several with one name below one joint, the first is that of the first, if both files have as many.
    """
    my_names, their_names = _names(mine), _names(theirs)
    my_parents, their_parents = scene.node_parents(mine), scene.node_parents(theirs)
    if my_names == their_names and my_parents == their_parents:
        return {node: node for node in joints}
    pairs: dict[int, int] = {}
    among = set(joints)
    for node in sorted(joints, key=lambda node: len(ancestors(my_parents, node))):
        # As many names count as there are joints from the node up.
        chain = ancestors(my_parents, node)
        chain = chain[: sum(n in among for n in chain)]
        wanted = [my_names[n] for n in chain]
        same = [n for n in joints if my_names[n] == wanted[0]]
        others = [other for other, name in enumerate(their_names) if name == wanted[0]]
        found = [o for o in others if [their_names[n] for n in ancestors(their_parents, o)[: len(chain)]] == wanted]
        alike = [s for s in same if [my_names[n] for n in ancestors(my_parents, s)[: len(chain)]] == wanted]
        if my_parents[node] in pairs:
            found = [other for other in found if their_parents[other] == pairs[my_parents[node]]]
            alike = [n for n in alike if my_parents[n] == my_parents[node]]
        if len(found) > len(alike):  # a mesh may have the name of a joint: that has nothing below it
            found = [other for other in found if "mesh" not in theirs.gltf["nodes"][other]]
        if len(found) == len(alike):
            pairs[node] = found[alike.index(node)]
    return pairs


def _names(document: Document) -> list[str]:
    return [scene.node_name(document, node) for node in range(len(document.gltf.get("nodes", [])))]


def _parent_frames(document: Document, nodes: list[int]) -> Float[np.ndarray, "K 4 4"]:
    """Compute the transform of each node at rest in its parent's frame, in the unit of the parent."""
    world, parent = rest_matrices(document), scene.node_parents(document)
    static = scene.local_matrices(document)
    chosen = set(nodes)
    frames = [
        np.linalg.pinv(world[parent[node]]) @ world[node] if parent[node] in chosen else static[node] for node in nodes
    ]
    return np.array(frames).reshape(-1, 4, 4)


def _same_above(mine: Document, theirs: Document, pairs: dict[int, int]) -> bool:
    """Tell whether the nodes above the roots of both skeletons have the same axes and unit."""
    my_world, their_world = (scene.world_matrices(document) for document in (mine, theirs))
    my_parents, their_parents = scene.node_parents(mine), scene.node_parents(theirs)
    for node, other in pairs.items():
        if my_parents[node] in pairs:
            continue
        above = [
            np.eye(4) if parents[n] < 0 else world[parents[n]]
            for world, parents, n in ((my_world, my_parents, node), (their_world, their_parents, other))
        ]
        size = np.abs(above[0][:3, :3]).max()
        if np.abs(above[0][:3, :3] - above[1][:3, :3]).max() > SAME_ROTATION * size:
            return False
    return True


def _other_sources(
    mine: Document, theirs: Document, values: AnimatedValues, pairs: dict[int, int]
) -> dict[tuple[int, str], tuple[int, str]]:
    """Find what is copied to nodes that are no joints, by name: props, and weights of meshes with the same targets.

    Targets are the same if they have the same names, or if one of the files does not name them, the same number. Of
    several nodes with one name the first is that of the first, and so on.
    """
    their_names, my_names = _names(theirs), _names(mine)
    partner = {other: node for node, other in pairs.items()}
    sources: dict[tuple[int, str], tuple[int, str]] = {}
    for other, path in values:
        if other in partner and path != "weights":
            continue
        alike = [n for n, name in enumerate(their_names) if name == their_names[other] and n not in partner]
        nodes = [n for n, name in enumerate(my_names) if name == their_names[other] and n not in pairs]
        if other in partner:
            node = partner[other]
        elif mine is theirs or my_names == their_names:
            node = other
        elif alike.index(other) < len(nodes):
            node = nodes[alike.index(other)]
        else:
            continue
        count = values[other, path].shape[1]
        if path != "weights" or (count == scene.target_count(mine, node) and _same_targets(mine, node, theirs, other)):
            sources[node, path] = (other, path)
    return sources


def _same_targets(mine: Document, node: int, theirs: Document, other: int) -> bool:
    names = target_names(mine, node), target_names(theirs, other)
    return not all(names) or names[0] == names[1]


def named_weights(
    document: Document, channels: Sequence[AnimationChannel], times: Float[np.ndarray, " T"]
) -> list[NamedWeights]:
    """Read the animated weights of all morph targets with names, and of the expressions of a VRM animation."""
    expressions = {node: name for name, node in animated_expressions(document).items()}
    found = []
    for channel in channels:
        if channel.path == "weights":
            values, owner = channel.sample(times), str(document.gltf["nodes"][channel.node].get("name", ""))
            names = target_names(document, channel.node)
            found += [NamedWeights(name, owner, column) for name, column in zip(names, values.T, strict=False)]
        elif channel.path == "translation" and channel.node in expressions:
            weights = np.clip(channel.sample(times)[:, 0], 0.0, 1.0)
            found.append(NamedWeights(expressions[channel.node], None, weights))
    return found


def morph_tracks(document: Document, weights: Sequence[NamedWeights]) -> AnimatedValues:
    """Compute the morph weights of all nodes of a file that has targets or expressions of the given names.

    A target has the weight of its name, else the sum of the expressions that move it, else the weight of the file.
    """
    tracks: AnimatedValues = {}
    by_expression = _expression_weights(vrm_expressions(document), weights)
    for node, entry in enumerate(document.gltf.get("nodes", [])):
        count = scene.target_count(document, node)
        if not count:
            continue
        columns = {index: values for (n, index), values in by_expression.items() if n == node and index < count}
        for index, name in enumerate(target_names(document, node)[:count]):
            values = _find_weights(weights, name, str(entry.get("name", "")))
            if values is not None:
                columns[index] = values
        if columns:
            track = np.tile(scene.read_morph_weights(document, node), (len(next(iter(columns.values()))), 1))
            for index, values in columns.items():
                track[:, index] = values
            tracks[node, "weights"] = track
    return tracks


def target_names(document: Document, node: int) -> list[str]:
    """Return the names of the morph targets of a node's mesh; empty where they have none."""
    mesh = document.gltf["nodes"][node].get("mesh")
    if mesh is None:
        return []
    entry = document.gltf["meshes"][mesh]
    # VRM 0.x has the names in the first primitive.
    for holder in (entry, *entry["primitives"][:1]):
        extras = holder.get("extras")
        names = extras.get("targetNames") if isinstance(extras, dict) else None
        if isinstance(names, list) and all(isinstance(name, str) for name in names):
            return names
    return []


def plain_target(name: str) -> str:
    """Simplify the name of a target: lower case, only letters and digits, sides written out."""
    name = _PREFIX.sub("", name)
    if side := _SIDE.search(name):
        name = name[: side.start()] + ("left" if (side[1] or side[2]).lower() == "l" else "right")
    return _LETTERS.sub("", name.lower())


def _find_weights(weights: Sequence[NamedWeights], name: str, owner: str | None) -> Float[np.ndarray, " T"] | None:
    """Find the weights of a name: equal before similar, of the same node before others, moving before still."""
    plain = plain_target(name)
    found = [row for row in weights if row.name == name] or [row for row in weights if plain_target(row.name) == plain]
    best = max(found, key=lambda row: (row.owner == owner, np.abs(row.values).max()), default=None)
    return None if best is None else best.values


def _expression_weights(
    expressions: dict[str, Expression], weights: Sequence[NamedWeights]
) -> dict[tuple[int, int], np.ndarray]:
    """Add up the weights of each (node, target) over the expressions of an identity that the driving animates."""
    values = {}
    for name, expression in expressions.items():
        found = _find_weights(weights, name, None)
        if found is not None and expression.binds:
            values[name] = (found > BINARY).astype(float) if expression.binary else found
    total: dict[tuple[int, int], np.ndarray] = {}
    for name, shown in values.items():
        # The share of an expression that others leave of it (VRM 1.0, Procedural override).
        factor = np.ones_like(shown)
        for key in (key for key, reducible in OVERRIDDEN.items() if name in reducible):
            for other, weight in values.items():
                if other not in OVERRIDDEN[key] and key in expressions[other].overrides:
                    factor -= weight > NEGLIGIBLE if expressions[other].overrides[key] == "block" else weight
        factor = np.maximum(factor, 0.0)
        # What has no intermediate values is suppressed by any reduction.
        reduced = shown * (factor >= 1.0 if expressions[name].binary else factor)
        for node, index, share in expressions[name].binds:
            total[node, index] = total.get((node, index), 0.0) + share * reduced
    return total
