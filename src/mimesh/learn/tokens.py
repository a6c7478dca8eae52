"""Transformer blocks of few tokens that look at many points."""

from __future__ import annotations

import math

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


class Block(nn.Module):
    """Pre-norm transformer block; `looks` adds attention to the points before that among tokens."""

    def __init__(self, width: int, heads: int, looks: bool) -> None:
        super().__init__()
        self.look = Attention(width, heads) if looks else None
        self.attend = Attention(width, heads)
        self.up, self.down = nn.Linear(width, 3 * width), zero(nn.Linear(3 * width, width))

    def forward(self, tokens: Float[Tensor, "B K C"], seen: Float[Tensor, "B N C"] | None = None) -> Tensor:
        if self.look is not None and seen is not None:
            tokens = tokens + self.look(rms(tokens), seen)
        h = rms(tokens)
        tokens = tokens + self.attend(h, h)
        return tokens + self.down(F.relu(self.up(rms(tokens))).square())


class Attention(nn.Module):
    """Multi-head attention with q and k of one length."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.out = zero(nn.Linear(width, width, bias=False))

    def forward(self, tokens: Float[Tensor, "B K C"], seen: Float[Tensor, "B N C"]) -> Float[Tensor, "B K C"]:
        q, k, v = (
            layer(h).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer, h in ((self.query, tokens), (self.key, seen), (self.value, seen))
        )
        scores = rms(q) @ rms(k).mT * (2.0 / math.sqrt(q.shape[-1]))
        return self.out((scores.softmax(-1) @ v).transpose(1, 2).flatten(2))


def rms(h: Tensor) -> Tensor:
    """Root mean square 1 over the channels."""
    return F.rms_norm(h, h.shape[-1:])


def zero(layer: nn.Linear) -> nn.Linear:
    """A layer that gives zeros at first."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer
