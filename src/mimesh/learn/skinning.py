"""Linear blend skinning of an identity from its own joints to the rotations of a driving mesh."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def posed_joints(
    rotation: Float[Tensor, "B J 3 3"],
    joints: Float[Tensor, "B J 3"],
    target: Float[Tensor, "B J 3 3"],
    root: Float[Tensor, "B 3"],
    parents: tuple[int, ...],
) -> Float[Tensor, "B J 3"]:
    """Where the joints of a skeleton are once each is turned to `target`; bones keep their lengths."""
    place = [root]
    for j, parent in enumerate(parents[1:], 1):
        bone = rotation[:, parent].mT @ (joints[:, j] - joints[:, parent])[..., None]
        place.append(place[parent] + (target[:, parent] @ bone)[..., 0])
    return torch.stack(place, 1)


def skinned(
    vertices: Float[Tensor, "B V 3"],
    weights: Float[Tensor, "B V J"],
    rotation: Float[Tensor, "B J 3 3"],
    joints: Float[Tensor, "B J 3"],
    target: Float[Tensor, "B J 3 3"],
    target_joints: Float[Tensor, "B J 3"],
) -> Float[Tensor, "B V 3"]:
    """Vertices moved by each joint from where it is to where it goes, blended by the weights."""
    turned = target @ rotation.mT
    offset = target_joints - (turned @ joints[..., None])[..., 0]
    blended = (weights @ torch.cat([turned, offset[..., None]], -1).flatten(2)).unflatten(2, (3, 4))
    return (blended[..., :3] @ vertices[..., None])[..., 0] + blended[..., 3]
