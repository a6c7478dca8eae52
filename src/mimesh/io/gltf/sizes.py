"""Checks what the JSON of a glTF file asks for against the budgets, before anything is allocated for it.

A few characters of JSON show one mesh many times, or claim any number of values.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from ...core.budgets import DEPTH, FACES, MORPHED, SHOWN, VERTICES


def check_sizes(gltf: dict[str, Any], size: int, path: Path) -> None:
    """Check the numbers of vertices, triangles and morph targets that nodes show, each as often as shown.

    Args:
        gltf: the JSON, checked by `check_document`.
        size: bytes of all buffers.

    Raises:
        InputError: a number is above its budget, or too many nodes are below each other.
    """
    nodes, accessors = gltf.get("nodes", []), gltf.get("accessors", [])
    _check_depth(nodes, path)
    parts = corners = morphed = 0
    for mesh, shown in Counter(node["mesh"] for node in nodes if "mesh" in node).items():
        deformed = set()  # primitives with the same vertices, one for each material, are deformed once
        for primitive in gltf["meshes"][mesh]["primitives"]:
            if "POSITION" not in primitive["attributes"]:
                continue
            position, targets = primitive["attributes"]["POSITION"], primitive.get("targets", [])
            count = accessors[position]["count"]
            indexed = accessors[primitive["indices"]]["count"] if "indices" in primitive else count
            VERTICES.check(count, path)
            parts += shown
            # Strips and fans have up to one triangle for each index, lists a third.
            corners += shown * indexed * (1 if primitive.get("mode", 4) == 4 else 3)
            key = (position, tuple(target.get("POSITION") for target in targets))
            morphed += shown * count * len(targets) if key not in deformed else 0
            deformed.add(key)
    SHOWN.check(parts, path)
    FACES.check(corners // 3, path)
    MORPHED.check(morphed, path, size)


def _check_depth(nodes: list[dict[str, Any]], path: Path) -> None:
    """Check how many nodes are below each other; loops are reported by those who walk the tree."""
    below = {child for node in nodes for child in node.get("children", [])}
    level = {index for index in range(len(nodes)) if index not in below}
    reached = set(level)
    depth = 0
    while level:
        depth += 1
        level = {child for index in level for child in nodes[index].get("children", [])} - reached
        reached |= level
    DEPTH.check(depth, path)
