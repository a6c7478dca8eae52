"""Makes a tree of the nodes of a damaged file, so that at least its surface can be read."""

from __future__ import annotations

from typing import Any


def cut_broken_links(gltf: dict[str, Any]) -> tuple[dict[str, Any], str | None]:
    """Leave out the links to children that make a loop or a second parent, where a file has skinned meshes.

    A walk from the roots of the scenes down keeps the first link to each node: links back up, which damaged skeletons
    have, come later. The rig of such a file is not used, because another link may have been the wrong one.

    Returns the JSON, the same object if it has a tree already, and what was wrong.
    """
    nodes = gltf.get("nodes", [])
    if not any("mesh" in node and "skin" in node for node in nodes):
        return gltf, None
    children: list[list[int]] = [[] for _ in nodes]
    found = {child for node in nodes for child in node.get("children", [])}
    listed = [root for scene in gltf.get("scenes", []) for root in scene.get("nodes", [])]
    loose = [node for node in range(len(nodes)) if node not in found]
    reached: set[int] = set()
    damage = None
    for root in [*listed, *loose, *range(len(nodes))]:
        if root in reached:
            continue
        reached.add(root)
        chain = [root]
        stack = [iter(nodes[root].get("children", []))]
        while stack:
            child = next(stack[-1], None)
            if child is None:
                stack.pop()
                chain.pop()
            elif child in reached:
                wrong = f"node {child} below itself" if child in chain else f"two parents of node {child}"
                damage = damage or f"expected a tree of nodes, found {wrong}"
            else:
                children[chain[-1]].append(child)
                reached.add(child)
                chain.append(child)
                stack.append(iter(nodes[child].get("children", [])))
    if damage is None:
        return gltf, None
    bare = ({key: value for key, value in node.items() if key != "children"} for node in nodes)
    tree = [node | ({"children": below} if below else {}) for node, below in zip(bare, children, strict=True)]
    return {**gltf, "nodes": tree}, damage
