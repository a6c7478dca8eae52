"""The batched torch twin of `bodies.RiggedBody`: the same people, thousands a second, on any device."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from ..bodies import RiggedBody


class TorchBody(nn.Module):
    """Arrays of a RiggedBody as buffers; `posed` gives the vertices that `RiggedBody.posed` gives."""

    vertices: Tensor
    components: Tensor
    joints: Tensor
    joint_components: Tensor
    weights: Tensor

    def __init__(self, body: RiggedBody, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.parents = body.parents
        for name in ("vertices", "components", "joints", "joint_components", "weights"):
            self.register_buffer(name, torch.from_numpy(getattr(body, name)).to(dtype))

    def posed(
        self,
        shape: Float[Tensor, "B K"],
        rotmat: Float[Tensor, "B J 3 3"],
        index: Int[Tensor, "B N"] | Int[Tensor, " N"] | None = None,
    ) -> Float[Tensor, "B N 3"]:
        """Vertices of people in poses; `index` picks vertices (one list for all, or one a sample) before any work."""
        transforms = self.skinning_transforms(shape, rotmat)
        if index is not None and index.ndim == 2:
            return self._skin_each(shape, transforms, index)
        pick = slice(None) if index is None else index
        # Blended matrix times vertex, kept as two products so that no (B, N, 3, 4) array is stored twice.
        rest = self.vertices[pick].flatten() + shape @ self.components[:, pick].flatten(1)
        rest = rest.view(len(shape), -1, 3, 1)
        blended = (self.weights[pick] @ transforms.flatten(2)).view(len(shape), -1, 3, 4)
        return (blended[..., :3] @ rest)[..., 0] + blended[..., 3]

    def _skin_each(self, shape, transforms, index):
        rest = self.vertices[index] + torch.einsum("bk,bnkc->bnc", shape, self.components.transpose(0, 1)[index])
        blended = (self.weights[index] @ transforms.flatten(2)).view(*index.shape, 3, 4)
        return (blended[..., :3] @ rest[..., None])[..., 0] + blended[..., 3]

    def skinning_transforms(
        self, shape: Float[Tensor, "B K"], rotmat: Float[Tensor, "B J 3 3"]
    ) -> Float[Tensor, "B J 3 4"]:
        """What each joint does to a rest point, as a 3x4 matrix."""
        joints = self.joints + torch.einsum("bk,kjc->bjc", shape, self.joint_components)
        rotation: list[Tensor] = []
        position: list[Tensor] = []
        for j, parent in enumerate(self.parents):
            if parent < 0:
                rotation.append(rotmat[:, j])
                position.append(joints[:, j])
            else:
                bone = (joints[:, j] - joints[:, parent])[..., None]
                rotation.append(rotation[parent] @ rotmat[:, j])
                position.append(position[parent] + (rotation[parent] @ bone)[..., 0])
        turned = torch.stack(rotation, 1)
        offset = torch.stack(position, 1)[..., None] - turned @ joints[..., None]
        return torch.cat([turned, offset], dim=-1)


def rotvec_to_rotmat(rotvec: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3 3"]:
    """Rotation matrices of rotation vectors in radians (Rodrigues' formula)."""
    angle = rotvec.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    x, y, z = (rotvec / angle).unbind(-1)
    sine, cosine = angle.sin()[..., None], angle.cos()[..., None]
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    eye = torch.eye(3, dtype=rotvec.dtype, device=rotvec.device)
    return eye + sine * cross + (1.0 - cosine) * (cross @ cross)
