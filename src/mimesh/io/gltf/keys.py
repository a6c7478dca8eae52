"""Chooses the keys of joint animations: the fewest from which linear interpolation stays within a tolerance.

Tracks have a value in each frame, at a constant rate. Clients interpolate rotations between two keys by slerp (glTF
2.0, 3.11 Animations), but Blender and some engines interpolate the components and normalize: both have to be within
the tolerance. Keys are values of the track itself.

New animations of the nodes of a file (`node_keys`) get the fewest rotations with which no vertex moves farther than a
limit; other values have all keys, or one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.geometry import continuous_quaternions
from ...core.mesh import Mesh
from ...core.rig import Rig, descendant_matrix, local_rotations
from .animation import LINEAR_COSINE, slerp, slerp_weights
from .document import Document
from .edit import GltfSource
from .read import rig_on_nodes
from .scene import node_parents, node_properties, normalized_quaternions

KEY_LIMIT = 1e-4
"""Largest distance, over the mesh's size, by which thinned keys move a vertex, or a joint in a file without vertices.
It is 0.2 mm for a person: motions that are found or retargeted are not known any better."""
COPY_LIMIT = 3e-6
"""The same for an animation that is copied between files with one skeleton: copies are exact to 1e-5 (see
docs/characters.md), of which float32 keys take a part."""
ACCESSOR_BYTES = 190
"""Characters of JSON that an accessor of key times takes, with its buffer view."""
SHORTEST_REACH = 0.05
"""Least distance, over the mesh's size, over which a rotation of a joint counts, even if it moves no vertex so far
away: users attach objects to joints without vertices."""
ROUNDING = 1e-7
"""Change of a value, over itself or over the mesh's size, that counts as none: float32 stores values no better."""
ROTATION_SHARE = 0.8
"""Share of the limit that thinned rotations may use; the rest is left to scales and to rounding."""
SCALE_SHARE = 0.05
"""Relative change of a scale, over the limit, that counts as none: scales that are computed from matrices in float32
change by up to 5e-6 where bones keep their lengths (measured on a file of Kenney's)."""
Tracks = Mapping[tuple[int, str], Float[np.ndarray, "_ _"]]
"""Values by (node, target path): in every frame, or in one of what does not move."""


def choose_keys(values: Float[np.ndarray, "J T 4"], tolerance: Float[np.ndarray, " J"]) -> Bool[np.ndarray, "J T"]:
    """Choose the frames of J tracks of rotations that become keys; one without motion gets one, in the first frame.

    The Douglas-Peucker algorithm: the frame with the largest error between two keys becomes a key, until all errors are
    within the tolerance. Segments of all tracks are split together. It takes 0.1 s for 61 joints in 300 frames and at
    most 1 % more keys than extending each segment as far as possible, which takes 10 s (measured on motion capture).

    Args:
        values: unit quaternions, each in the hemisphere of the one before.
        tolerance: largest angle in radians.
    """
    is_key = np.zeros(values.shape[:2], bool)
    is_key[:, 0] = True
    tracks = np.arange(len(values))
    last = np.full(len(values), values.shape[1] - 1)
    # Component by component: numpy takes several times as long for rows of four.
    components = np.ascontiguousarray(np.moveaxis(values, -1, 0))
    constant = _angle(_squared_distances(components, components[:, :, :1]).max(axis=1))
    moving = constant > tolerance
    is_key[moving, -1] = True
    segments = np.stack([tracks, np.zeros_like(last), last])[:, moving]  # rows: track, first and last frame
    while (segments := segments[:, segments[2] - segments[1] > 1]).size:
        worst_frame, worst = _worst_frames(components, segments)
        split = worst > tolerance[segments[0]]
        track, start, stop = segments[:, split]
        middle = worst_frame[split]
        is_key[track, middle] = True
        segments = np.concatenate([[track, start, middle], [track, middle, stop]], axis=1)
    return is_key


def local_quaternions(rotation: Float[np.ndarray, "T J 3 3"], parents: tuple[int, ...]) -> Float[np.ndarray, "T J 4"]:
    """Return each joint's rotation in the frame of its parent, from world rotations, as quaternions (x, y, z, w)."""
    from scipy.spatial.transform import Rotation

    local = local_rotations(rotation, parents)
    quat_xyzw = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_quat().reshape(*local.shape[:2], 4)
    return continuous_quaternions(quat_xyzw)


def played_values(values: Float[np.ndarray, "J T 4"], is_key: Bool[np.ndarray, "J T"]) -> Float[np.ndarray, "J T 4"]:
    """Compute the rotations in all frames that clients interpolate from the keys."""
    frames = np.arange(values.shape[1])
    before = np.maximum.accumulate(np.where(is_key, frames, 0), axis=1)
    after = np.minimum.accumulate(np.where(is_key, frames, len(frames))[:, ::-1], axis=1)[:, ::-1]
    after = np.where(after < len(frames), after, before)  # after its last key a track keeps the value of that key
    s = (frames - before) / np.maximum(after - before, 1)
    track = np.arange(len(values))[:, None]
    a, b = (values[track, keys].reshape(-1, 4) for keys in (before, after))
    return _interpolate(a, b, s.reshape(-1, 1)).reshape(values.shape)


def rotation_tolerances(
    vertices: Float[np.ndarray, "V 3"], rig: Rig, parents: tuple[int, ...], limit: float
) -> Float[np.ndarray, " J"]:
    """Compute the error of each joint's local rotation (radians) with which no vertex moves farther than `limit`.

    An error of a joint moves a vertex below it by at most the error times their distance in any pose, and the errors
    along a chain of joints add up: every joint gets an equal share of the limit, by the longest chain through it.
    """
    own = (np.linalg.norm(vertices[rig.weights[:, j] > 0] - joint, axis=1) for j, joint in enumerate(rig.joints))
    reach = np.array([distances.max(initial=0.0) for distances in own])
    bones = [float(np.linalg.norm(rig.joints[j] - rig.joints[parent])) for j, parent in enumerate(parents)]
    shortest = SHORTEST_REACH * np.ptp(vertices, axis=0).max()
    return _chain_tolerances(reach, bones, parents, limit, shortest, np.ones(len(parents), bool))


def _chain_tolerances(
    reach: Float[np.ndarray, " J"],
    bones: list[float],
    parents: tuple[int, ...],
    limit: float,
    shortest: float,
    turns: Bool[np.ndarray, " J"],
) -> Float[np.ndarray, " J"]:
    """Divide a limit among the joints that turn in the longest chain through each joint.

    Args:
        reach: largest distance from each joint to a vertex that it moves itself.
        bones: largest distance from each joint to its parent.
        shortest: least distance to a vertex, of a joint or one below it, that counts.

    Returns:
        Largest error of each joint's rotation, in radians.
    """
    reach = reach.copy()
    for j in range(len(parents) - 1, -1, -1):  # children before their parents
        if parents[j] >= 0 and reach[j] > 0:
            reach[parents[j]] = max(reach[parents[j]], bones[j] + reach[j])
    below = descendant_matrix(parents)
    depth = (turns[:, None] * below).sum(axis=0)  # joints from the root down to each joint, itself included
    longest_chain = np.maximum((below * depth).max(axis=1), 1)
    return limit / (longest_chain * np.maximum(reach, shortest))


def without_costly_times(is_key: Bool[np.ndarray, "J T"]) -> Bool[np.ndarray, "J T"]:
    """Give all keys to the tracks of rotations whose own key times would take more room than they save."""
    count = is_key.sum(axis=1)
    own_times = count * (4 + 16) + ACCESSOR_BYTES  # bytes of a time and a quaternion in float32
    costly = (count > 1) & (own_times > is_key.shape[1] * 16)
    return is_key | costly[:, None]


def _worst_frames(
    values: Float[np.ndarray, "4 J T"], segments: Int[np.ndarray, "3 S"]
) -> tuple[Int[np.ndarray, " S"], Float[np.ndarray, " S"]]:
    """Find the frame inside each segment with the largest error of interpolation, and this error (radians).

    The error is the worse one of slerp and of the interpolation of components.
    """
    track, start, stop = segments
    count = stop - start - 1
    first = np.cumsum(count) - count  # index of each segment's first inner frame among those of all segments
    inner = np.arange(1, count.sum() + 1) - np.repeat(first, count)  # frames after the start
    s = inner / np.repeat(stop - start, count)
    frames, begin = values.reshape(4, -1), track * values.shape[2] + start
    wanted = frames.take(np.repeat(begin, count) + inner, axis=1)
    a, b = frames.take(begin, axis=1), frames.take(begin + stop - start, axis=1)
    error = _squared_distances(wanted, _blend(a, b, count, 1 - s, s))
    cosine = (a * b).sum(axis=0)
    far = cosine <= LINEAR_COSINE  # of nearer ones slerp is the same
    if far.any():
        inside, count_far = np.repeat(far, count), count[far]
        angle = np.repeat(np.arccos(np.minimum(np.abs(cosine[far]), 1.0)), count_far)
        shorter = np.where(cosine[far] < 0, -b[:, far], b[:, far])
        by_slerp = _blend(a[:, far], shorter, count_far, *slerp_weights(angle, s[inside]))
        error[inside] = np.maximum(error[inside], _squared_distances(wanted[:, inside], by_slerp))
    worst = np.maximum.reduceat(error, first)
    found = np.flatnonzero(error == np.repeat(worst, count))
    return start + inner[found[np.searchsorted(found, first)]], _angle(worst)


def _blend(
    a: Float[np.ndarray, "4 S"],
    b: Float[np.ndarray, "4 S"],
    count: Int[np.ndarray, " S"],
    of_a: Float[np.ndarray, " N"],
    of_b: Float[np.ndarray, " N"],
) -> Float[np.ndarray, "4 N"]:
    """Blend the ends of segments for each of their `count` inner frames."""
    return np.repeat(a, count, axis=1) * of_a + np.repeat(b, count, axis=1) * of_b


def _squared_distances(
    values: Float[np.ndarray, "4 *N"], others: Float[np.ndarray, "4 *#N"]
) -> Float[np.ndarray, "*N"]:
    """Compute the squared distances of unit quaternions from others, which are normalised first; zeros stay zero."""
    length = np.sqrt(np.square(others).sum(axis=0))
    return np.square(values - others / np.where(length > 0, length, 1.0)).sum(axis=0)


def _angle(squared: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Compute the angle (radians) between rotations from the squared distance of their unit quaternions."""
    # Two unit quaternions with the angle x between them are rotations 2 x apart, and their distance is 2 sin(x / 2).
    return 4 * np.arcsin(np.minimum(np.sqrt(squared) / 2, 1.0))


def _interpolate(
    a: Float[np.ndarray, "N 4"], b: Float[np.ndarray, "N 4"], s: Float[np.ndarray, "#N 1"] | float
) -> Float[np.ndarray, "N 4"]:
    """Interpolate unit quaternions by slerp, at s in 0..1 between a and b."""
    return normalized_quaternions(slerp(a, b, np.broadcast_to(s, (len(a), 1))))


def node_keys(source: GltfSource, tracks: Tracks, limit: float) -> dict[tuple[int, str], Bool[np.ndarray, " _"]]:
    """Choose the frames of animated values that become keys; what stays the same has one, in the first frame.

    Args:
        limit: distance, over the mesh's size, by which thinned rotations may move a vertex.
    """
    keys = {}
    for key, values in tracks.items():
        still = rounding(source, key, values)
        if key[1] == "scale":
            still = max(still, SCALE_SHARE * limit * float(np.abs(values).max()))
        moves = np.abs(values - values[0]).max() > still
        keys[key] = np.full(len(values), moves) | (np.arange(len(values)) == 0)
    turning = [key for key, is_key in keys.items() if key[1] == "rotation" and is_key.sum() > 1]
    if not turning:
        return keys
    quaternions = normalized_quaternions(np.stack([tracks[key] for key in turning]))
    tolerance = _node_tolerances(source, tracks, {node for node, _ in turning}, ROTATION_SHARE * limit)
    chosen = choose_keys(quaternions, np.array([tolerance[node] for node, _ in turning]))
    return keys | dict(zip(turning, without_costly_times(chosen), strict=True))


def rounding(source: GltfSource, key: tuple[int, str], values: Float[np.ndarray, "T C"]) -> float:
    """Return the change of animated values that is no more than rounding, in their unit."""
    node, path = key
    unit = {"rotation": 1.0, "weights": 1.0}.get(path, 0.0)
    if path == "translation" and node < len(source.rest.T_world_node):
        size = float(np.ptp(source.vertices, axis=0).max())
        unit = size / max(_scale_above(source, node_parents(source.document)[node]), 1e-12)
    return ROUNDING * max(float(np.abs(values).max()), unit)


def _scale_above(source: GltfSource, parent: int) -> float:
    """Return by how much the nodes from the scene to a node, which may be none (-1), enlarge what is below it."""
    return 1.0 if parent < 0 else float(np.linalg.norm(source.rest.T_world_node[parent, :3, :3], axis=0).max())


def _node_tolerances(source: GltfSource, tracks: Tracks, turning: set[int], limit: float) -> dict[int, float]:
    """Compute the error of each turning node's rotation (radians) with which no vertex moves farther than `limit`.

    As `rotation_tolerances`: each node has an equal share of the limit, among those that turn in the longest chain
    through it.
    """
    document, above = source.document, node_parents(source.document)
    skinned = {joint for skin in document.gltf.get("skins", []) for joint in skin["joints"]}
    mesh = Mesh(source.vertices, np.zeros((0, 3), np.int64))
    listed = {node for node, _ in tracks if node < len(above)} | turning | skinned
    rig, nodes = rig_on_nodes(mesh, document, source.rest, listed)
    size = float(np.ptp(source.vertices, axis=0).max())
    reach = np.zeros(len(nodes) + 1)  # the last one is the world
    distance = np.linalg.norm(rig.points - np.pad(rig.joints, ((0, 1), (0, 0)))[rig.joint_of], axis=-1)
    np.maximum.at(reach, rig.joint_of[rig.weights > 0], distance[rig.weights > 0])
    bones = [
        float(np.linalg.norm(rig.joints[j] - rig.joints[parent]))
        + _farthest(document, tracks, nodes[j]) * _scale_above(source, above[nodes[j]])
        for j, parent in enumerate(rig.parents)
    ]
    turns = np.array([node in turning for node in nodes])
    tolerances = _chain_tolerances(reach[:-1], bones, rig.parents, limit * size, SHORTEST_REACH * size, turns)
    return dict(zip(nodes, tolerances.tolist(), strict=True))


def _farthest(document: Document, tracks: Tracks, node: int) -> float:
    """Return how far an animation moves a node from its place in the frame of its parent."""
    path = tracks.get((node, "translation"))
    if path is None:
        return 0.0
    still = node_properties(document.gltf["nodes"][node])["translation"]
    return float(np.linalg.norm(path - still, axis=1).max())
