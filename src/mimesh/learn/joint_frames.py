"""Frames of joints, what they see of the points near them, and how they are mended by it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from .tokens import Block, rms, zero

GEOMETRY = 10
"""Numbers that describe a point in a joint's frame."""
CLOSE = 4.0
"""What positions in a joint's frame are multiplied by."""


@dataclass(frozen=True)
class Frames:
    """Where the joints are thought to be."""

    rotation: Float[Tensor, "B J 3 3"]
    joints: Float[Tensor, "B J 3"]

    def of(self, points: Float[Tensor, "B #J N 3"], normals: Float[Tensor, "B #J N 3"]) -> Float[Tensor, "B J N G"]:
        """Points and their normals as each joint sees them."""
        with torch.autocast(points.device.type, enabled=False):
            x = CLOSE * (points - self.joints[:, :, None]) @ self.rotation
            return torch.cat([x, x.norm(dim=-1, keepdim=True), normals @ self.rotation, (2 * x).sin()], -1)

    def changed(self, nine: Float[Tensor, "B J 9"]) -> tuple[Float[Tensor, "B J 3 3"], Float[Tensor, "B J 3"]]:
        """Each frame turned by the first six numbers and moved by the last three, as seen from itself."""
        with torch.autocast(nine.device.type, enabled=False):
            moved = self.joints + (self.rotation @ nine[..., 6:, None])[..., 0]
            return self.rotation @ turn(nine[..., :6]), moved

    def at(self, places: Float[Tensor, "J 3"]) -> Float[Tensor, "B J 3"]:
        """Where a place in each frame is."""
        with torch.autocast(self.joints.device.type, enabled=False):
            return self.joints + (self.rotation @ places[..., None])[..., 0]


class Mending(nn.Module):
    """Each joint looks at the points near it, in its own frame, and turns and moves that frame."""

    middle: Tensor

    def __init__(self, middle: Float[Tensor, "J 3"], width: int, heads: int, local: int, near: int) -> None:
        """`middle` is that of each joint's surface, in its frame: around it, `near` points are looked at."""
        super().__init__()
        self.near = near
        self.register_buffer("middle", middle, persistent=False)
        self.geometry, self.token = nn.Linear(GEOMETRY, local), nn.Linear(width, local)
        self.seen = nn.Linear(width, local, bias=False)
        self.score = nn.Linear(local, heads)
        self.pooled = nn.Linear(heads * local, width)
        self.block = Block(width, heads, looks=False)
        self.mend = zero(nn.Linear(width, 9))

    def forward(
        self,
        tokens: Float[Tensor, "B K C"],
        frames: Frames,
        points: tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"], Float[Tensor, "B N H"]],
    ) -> tuple[Float[Tensor, "B K C"], Float[Tensor, "B J 3 3"], Float[Tensor, "B J 3"]]:
        """New tokens, of which the last J are the joints', and frames; `points` are places, normals, and `seen`."""
        x, normals, seen = points
        with torch.no_grad():
            apart = torch.cdist(frames.at(self.middle), x)
            index = apart.topk(min(self.near, x.shape[1]), dim=2, largest=False, sorted=False).indices
        others, ours = tokens.split([tokens.shape[1] - frames.joints.shape[1], frames.joints.shape[1]], 1)
        h = self.geometry(frames.of(_pick(x, index), _pick(normals, index)))
        h = F.relu(h + self.token(rms(ours))[:, :, None] + _pick(seen, index))
        share = self.score(h).float().softmax(2).to(h.dtype)
        ours = ours + self.pooled((share.mT @ h).flatten(2))
        tokens = self.block(torch.cat([others, ours], 1))
        return tokens, *frames.changed(self.mend(rms(tokens[:, -ours.shape[1] :])).float())


def turn(six: Float[Tensor, "*B 6"]) -> Float[Tensor, "*B 3 3"]:
    """Rotation of six numbers (Zhou et al., CVPR 2019): zeros are no turn."""
    x = F.normalize(six[..., :3] + six.new_tensor([1.0, 0.0, 0.0]), dim=-1)
    y = six[..., 3:] + six.new_tensor([0.0, 1.0, 0.0])
    y = F.normalize(y - (x * y).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], -1)


def _pick(values: Float[Tensor, "B N C"], index: Tensor) -> Float[Tensor, "B J M C"]:
    flat = index.flatten(1)[..., None].expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).unflatten(1, index.shape[1:])
