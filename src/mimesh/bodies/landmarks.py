"""Named points of a body, found by rules from its rest pose: what a person would click on to mark a correspondence."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from .body_model import RiggedBody

EXTREMES = {
    "head": ("Head", (0.0, 1.0, 0.0)),
    "left hand": ("LeftHand", (1.0, 0.0, 0.0)),
    "right hand": ("RightHand", (-1.0, 0.0, 0.0)),
    "left foot": ("LeftToeBase", (0.0, 0.0, 1.0)),
    "right foot": ("RightToeBase", (0.0, 0.0, 1.0)),
}
"""The vertex farthest in a direction from a joint, among those near the line through the joint."""
ON_SKIN = {
    "left shoulder": ("LeftArm", (0.0, 1.0, 0.0)),
    "right shoulder": ("RightArm", (0.0, 1.0, 0.0)),
    "left elbow": ("LeftForeArm", (0.0, 0.0, -1.0)),
    "right elbow": ("RightForeArm", (0.0, 0.0, -1.0)),
    "left hip": ("LeftUpLeg", (1.0, 0.0, 0.0)),
    "right hip": ("RightUpLeg", (-1.0, 0.0, 0.0)),
    "left knee": ("LeftLeg", (0.0, 0.0, 1.0)),
    "right knee": ("RightLeg", (0.0, 0.0, 1.0)),
}
"""The vertex of the skin where a ray from a joint leaves the body (the first crossing, roughly: nearest to the ray)."""
LANDMARKS = (*EXTREMES, *ON_SKIN)
"""All 13 in order; the first 5 are the ends of the body."""
NEAR = 0.06
"""Metres around the line through a joint in which an extreme is looked for; a palm or a foot is narrower."""


def landmarks(body: RiggedBody) -> dict[str, int]:
    """Vertex index of each of LANDMARKS on a human body; shape and pose do not matter, the vertex stays the same."""
    found = {name: _extreme(body, joint, np.array(way)) for name, (joint, way) in EXTREMES.items()}
    return found | {name: _on_skin(body, joint, np.array(way)) for name, (joint, way) in ON_SKIN.items()}


def _along_and_aside(
    body: RiggedBody, joint: str, way: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]]:
    """Of each vertex: how far it lies in a direction from a joint, and how far from that line."""
    offset = body.vertices - body.joints[body.joint(joint)]
    along = offset @ way
    return along, np.linalg.norm(offset - along[:, None] * way, axis=1)


def _extreme(body: RiggedBody, joint: str, way: Float[np.ndarray, " 3"]) -> int:
    along, aside = _along_and_aside(body, joint, way)
    return int(np.where(aside < NEAR, along, -np.inf).argmax())


def _on_skin(body: RiggedBody, joint: str, way: Float[np.ndarray, " 3"]) -> int:
    """Nearest to the ray among vertices that follow this joint or its parent; far ones lose by their distance."""
    along, aside = _along_and_aside(body, joint, way)
    index = body.joint(joint)
    follows = body.weights[:, index] + body.weights[:, body.parents[index]] > 0.5
    return int(np.where(follows & (along > 0), aside + 0.1 * along, np.inf).argmin())
