"""Write a body model as the file that the package ships."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mimesh.bodies import RiggedBody


def save_body(body: RiggedBody, path: Path) -> None:
    """Write a compact `.npz`: components and weights in half precision, the six largest weights per vertex."""
    strongest = np.argsort(-body.weights, axis=1)[:, :6]
    np.savez_compressed(
        path,
        vertices=body.vertices.astype(np.float32),
        faces=body.faces.astype(np.uint16),
        components=body.components.astype(np.float16),
        joints=body.joints.astype(np.float32),
        joint_components=body.joint_components.astype(np.float32),
        weight_joints=strongest.astype(np.uint8),
        weights=np.take_along_axis(body.weights, strongest, axis=1).astype(np.float16),
        joint_names=np.array(body.joint_names),
        parents=np.array(body.parents, np.int8),
    )
