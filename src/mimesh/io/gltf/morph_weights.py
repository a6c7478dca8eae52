"""Copies animated weights of morph targets between files by the names of the targets, such as the 52 of ARKit.

Names are in `extras.targetNames` of a mesh, a convention of most tools. Equal names count before other spellings of the
same words: browInnerUp, BrowInnerUp, brow_inner_up; mouthSmileLeft, mouthSmile_L. Expressions of VRM are names too: a
VRM identity has them as sums of its targets' weights, and a VRM animation (.vrma) animates them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .animation import AnimationChannel
from .bake import AnimatedValues
from .document import Document
from .scene import read_morph_weights, target_count
from .vrm import OVERRIDDEN, Expression, animated_expressions, vrm_expressions

BINARY = 0.5
"""Weight above which an expression without intermediate values is full (VRM 1.0, expressions.md)."""
NEGLIGIBLE = 1e-5
"""Weight of an expression that counts as none: frames are not exactly at the times of keys, which are float32."""
_PREFIX = re.compile(r"^blendshapes?\d*\.", re.IGNORECASE)
"""Name of Maya's node before that of the target."""
_SIDE = re.compile(r"(?:[_. -]([lrLR])|(?<=[a-z])([LR]))$")
_LETTERS = re.compile(r"[^a-z0-9]")


@dataclass(frozen=True, eq=False)
class NamedWeights:
    """Weights of a morph target or an expression of a driving file, in every frame."""

    name: str
    owner: str | None
    """Name of the node that shows the mesh; None for an expression."""
    values: Float[np.ndarray, " T"]


Find = Callable[[str, str | None], Float[np.ndarray, " T"] | None]
"""Finds the weights of a name and of the node that has a target of this name; None: the driving has no such name."""


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
    find = _finder(weights)
    tracks: AnimatedValues = {}
    by_expression = _expression_weights(vrm_expressions(document), find)
    for node, entry in enumerate(document.gltf.get("nodes", [])):
        count = target_count(document, node)
        if not count:
            continue
        columns = {index: values for (n, index), values in by_expression.items() if n == node and index < count}
        for index, name in enumerate(target_names(document, node)[:count]):
            values = find(name, str(entry.get("name", "")))
            if values is not None:
                columns[index] = values
        if columns:
            track = np.tile(read_morph_weights(document, node), (len(next(iter(columns.values()))), 1))
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


def _finder(weights: Sequence[NamedWeights]) -> Find:
    """Return the search for a name: equal before similar, of the same node before others, moving before still."""

    def find(name: str, owner: str | None) -> Float[np.ndarray, " T"] | None:
        plain = plain_target(name)
        found = [row for row in weights if row.name == name] or [r for r in weights if plain_target(r.name) == plain]
        best = max(found, key=lambda row: (row.owner == owner, np.abs(row.values).max()), default=None)
        return None if best is None else best.values

    return find


def _expression_weights(expressions: dict[str, Expression], find: Find) -> dict[tuple[int, int], np.ndarray]:
    """Add up the weights of each (node, target) over the expressions of an identity that the driving animates."""
    values = {}
    for name, expression in expressions.items():
        found = find(name, None)
        if found is not None and expression.binds:
            values[name] = (found > BINARY).astype(float) if expression.binary else found
    total: dict[tuple[int, int], np.ndarray] = {}
    for name, weights in values.items():
        factor = _remaining(name, expressions, values)
        # What has no intermediate values is suppressed by any reduction.
        reduced = weights * (factor >= 1.0) if expressions[name].binary else weights * factor
        for node, index, share in expressions[name].binds:
            total[node, index] = total.get((node, index), 0.0) + share * reduced
    return total


def _remaining(
    name: str, expressions: dict[str, Expression], values: dict[str, Float[np.ndarray, " T"]]
) -> Float[np.ndarray, " T"]:
    """Compute the share of an expression that others leave of it (VRM 1.0, Procedural override)."""
    factor = np.ones_like(values[name])
    for key, reduced in OVERRIDDEN.items():
        if name not in reduced:
            continue
        for other, weights in values.items():
            if other not in reduced and key in expressions[other].overrides:
                factor -= weights > NEGLIGIBLE if expressions[other].overrides[key] == "block" else weights
    return np.maximum(factor, 0.0)
