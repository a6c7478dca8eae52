"""Prepare a glTF file for Blender's FBX exporter: all animations one after the other, and all moving nodes joints.

The exporter writes a take for each strip of time of one object. So the animations become one long animation, sampled
in every frame, of which each is a strip; and everything that moves becomes a bone of one armature.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...bodies.joint_names import ancestors
from ..gltf.animation import AnimationChannel, add_animation, animation_names, frame_rate, frame_times, read_channels
from ..gltf.document import Document, read_floats
from ..gltf.draft import AccessorCopier, Draft
from ..gltf.own_animation import node_value
from ..gltf.scene import node_parents, world_matrices
from ..timing import DEFAULT_FPS

GAP = 2
"""Frames between two animations, so that none begins where another ends."""
SHORTEST = 2
"""Frames of a pose: a strip of time needs an end after its beginning."""


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
    if clips:
        moved = dict.fromkeys(key for _, values in samples for key in values)
        still = {key: node_value(document.gltf["nodes"][key[0]], key, document) for key in moved}
        joined = []
        for key in moved:
            values = np.concatenate([of_one.get(key, np.repeat(still[key], count, 0)) for count, of_one in samples])
            joined.append(AnimationChannel(key[0], key[1], np.concatenate(times), values))
        draft.gltf["animations"] = [add_animation(draft, "all", joined)]
        _make_joints(draft, document, {node for node, path in moved if path != "weights"})
    return draft, {"fps": fps, "clips": clips}


def _make_joints(draft: Draft, document: Document, moved: set[int]) -> None:
    """Add a skin that no mesh uses, of the nodes that move and are no joints, and of a joint of each other skin.

    Blender makes the joints of a skin, and what is between them, bones of the armature at their common ancestor.
    """
    skins = draft.gltf.get("skins", [])
    extra = sorted(moved - {joint for skin in skins for joint in skin["joints"]})
    if not extra and len(skins) < 2:
        return
    inverse_bind: dict[int, np.ndarray] = {}
    for skin in skins:
        stored = np.tile(np.eye(4).ravel(), (len(skin["joints"]), 1))
        if "inverseBindMatrices" in skin:
            stored = read_floats(document, skin["inverseBindMatrices"])
        inverse_bind |= {joint: row.reshape(4, 4).T for joint, row in zip(skin["joints"], stored, strict=False)}
    world = world_matrices(document)
    near = _nearest_joints(document, extra, set(inverse_bind))
    for node, joint in near.items():
        # Skins may be bound in another space than the world: the node is placed as it is beside a joint.
        placed = np.eye(4) if joint is None else world[joint] @ inverse_bind[joint]
        inverse_bind[node] = np.linalg.pinv(world[node]) @ placed
    joints = sorted(inverse_bind)
    inverse = draft.add_matrices(np.stack([inverse_bind[joint] for joint in joints]))
    skin = {"name": "Armature", "joints": joints, "inverseBindMatrices": inverse}
    draft.gltf["skins"] = [*skins, skin]


def _nearest_joints(document: Document, nodes: list[int], joints: set[int]) -> dict[int, int | None]:
    """Find for each node the nearest joint above it, or else below it, or else any; None where there are no joints."""
    parent = tuple(node_parents(document))
    chains = {joint: ancestors(parent, joint) for joint in sorted(joints)}
    found: dict[int, int | None] = {}
    for node in nodes:
        above = next((other for other in ancestors(parent, node) if other in joints), None)
        below = min((joint for joint in chains if node in chains[joint]), key=lambda j: len(chains[j]), default=None)
        found[node] = next((joint for joint in (above, below, *chains) if joint is not None), None)
    return found
