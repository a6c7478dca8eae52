"""Principal components of bodies that share their vertices, with those of their joints."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def principal_components(
    bodies: Float[np.ndarray, "N V 3"], joints: Float[np.ndarray, "N J 3"], count: int
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "J 3"], Float[np.ndarray, "K V 3"], Float[np.ndarray, "K J 3"]]:
    """Compute means and principal components (scaled to one standard deviation) of vertices, with those of joints.

    Every body is first moved so that the centre of its bounding box is above the origin and its soles on the ground.
    """
    bodies, joints = on_ground(bodies, joints)
    flat = np.concatenate([bodies.reshape(len(bodies), -1), joints.reshape(len(joints), -1)], axis=1)
    mean = flat.mean(axis=0)
    # Joints do not influence the components; theirs are fitted to the scores of the vertices.
    split = bodies[0].size
    left, sigma, right = np.linalg.svd(flat[:, :split] - mean[:split], full_matrices=False)
    scores = left[:, :count] * np.sqrt(len(bodies))
    components = right[:count] * sigma[:count, None] / np.sqrt(len(bodies))
    joint_components = np.linalg.lstsq(scores, flat[:, split:] - mean[split:], rcond=None)[0]
    shape, joint_shape = bodies[0].shape, joints[0].shape
    return (
        mean[:split].reshape(shape),
        mean[split:].reshape(joint_shape),
        components.reshape(count, *shape),
        joint_components.reshape(count, *joint_shape),
    )


def on_ground(
    bodies: Float[np.ndarray, "N V 3"], joints: Float[np.ndarray, "N J 3"]
) -> tuple[Float[np.ndarray, "N V 3"], Float[np.ndarray, "N J 3"]]:
    """Move bodies so that the centre of each bounding box is above the origin and the lowest vertex at y = 0."""
    low, high = bodies.min(axis=1, keepdims=True), bodies.max(axis=1, keepdims=True)
    origin = np.concatenate([(low + high)[..., :1] / 2, low[..., 1:2], (low + high)[..., 2:] / 2], axis=-1)
    return bodies - origin, joints - origin


def residual_mm(
    bodies: Float[np.ndarray, "N V 3"], mean: Float[np.ndarray, "V 3"], components: Float[np.ndarray, "K V 3"]
) -> Float[np.ndarray, " N"]:
    """Compute the mean distance (mm) of each body on the ground from its least-squares fit by the components."""
    flat = (bodies - mean).reshape(len(bodies), -1)
    basis = components.reshape(len(components), -1)
    rest = flat - flat @ np.linalg.pinv(basis) @ basis
    return 1e3 * np.linalg.norm(rest.reshape(len(bodies), -1, 3), axis=-1).mean(axis=1)
