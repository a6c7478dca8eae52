"""A clip with every feature of a mesh file: quads, a UV seam, two materials, a texture, vertex colours."""

from pathlib import Path

import numpy as np
from gltf_samples import png

from mimesh.core.mesh import Clip
from mimesh.io import load_mesh

AROUND, ALONG = 12, 10


def dressed_clip(folder: Path, frames: int = 6, fps: float = 24.0) -> Clip:
    """Write a tube as an OBJ file into a new folder, read it, and return it as a clip in which it bends; y up."""
    folder.mkdir()
    (folder / "skin.png").write_bytes(png())
    (folder / "tube.mtl").write_text("newmtl red skin\nKd 0.8 0.1 0.1\nmap_Kd skin.png\nnewmtl blue\nKd 0.1 0.1 0.8\n")
    (folder / "tube.obj").write_text("\n".join(obj_lines()) + "\n")
    mesh = load_mesh(folder / "tube.obj")
    x, y, z = mesh.vertices.T
    positions = [
        np.stack([x + 0.1 * t * np.sin(y + t), y + 0.02 * t**2, z * (1 + 0.05 * t * y)], axis=1).astype(np.float32)
        for t in range(frames)
    ]
    return Clip(mesh, np.stack(positions), fps)


def obj_lines() -> list[str]:
    """Return the OBJ file; the last column of quads closes the tube and has separate texture coordinates (a seam)."""
    lines = ["mtllib tube.mtl", "o tube"]
    for row in range(ALONG + 1):
        for a in range(AROUND):
            angle = 2 * np.pi * a / AROUND
            lines.append(
                f"v {0.3 * np.cos(angle):.6f} {2 * row / ALONG:.6f} {0.3 * np.sin(angle):.6f} {a / AROUND:.3f} 0.5 0.2"
            )
    lines += [f"vt {a / AROUND:.6f} {row / ALONG:.6f}" for row in range(ALONG + 1) for a in range(AROUND + 1)]
    for row in range(ALONG):
        lines.append(f"usemtl {'red skin' if row < ALONG // 2 else 'blue'}")
        for a in range(AROUND):
            corners = ((a, row), (a, row + 1), (a + 1, row + 1), (a + 1, row))
            lines.append(
                "f " + " ".join(f"{r * AROUND + c % AROUND + 1}/{r * (AROUND + 1) + c + 1}" for c, r in corners)
            )
    return lines
