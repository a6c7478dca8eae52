"""A clip with all that a file may carry: quads, a seam in the UVs, two materials, a texture, colours, hard edges."""

from pathlib import Path

import numpy as np
from gltf_samples import png

from mimesh.core.mesh import Clip
from mimesh.io import load_mesh

AROUND, ALONG = 12, 10


def dressed_clip(folder: Path, frames: int = 6, fps: float = 24.0) -> Clip:
    """A tube that bends, read from an OBJ file that is written into the folder; y up."""
    folder.mkdir()
    (folder / "skin.png").write_bytes(png())
    (folder / "tube.mtl").write_text("newmtl red skin\nKd 0.8 0.1 0.1\nmap_Kd skin.png\nnewmtl blue\nKd 0.1 0.1 0.8\n")
    (folder / "tube.obj").write_text("\n".join(lines()) + "\n")
    mesh = load_mesh(folder / "tube.obj")
    x, y, z = mesh.vertices.T
    bent = [
        np.stack([x + 0.1 * t * np.sin(y + t), y + 0.02 * t**2, z * (1 + 0.05 * t * y)], axis=1).astype(np.float32)
        for t in range(frames)
    ]
    return Clip(mesh, np.stack(bent), fps)


def lines() -> list[str]:
    """The OBJ file: corners of the last column of quads close the tube with texture coordinates of their own."""
    found = ["mtllib tube.mtl", "o tube"]
    for row in range(ALONG + 1):
        for a in range(AROUND):
            turn = 2 * np.pi * a / AROUND
            found.append(
                f"v {0.3 * np.cos(turn):.6f} {2 * row / ALONG:.6f} {0.3 * np.sin(turn):.6f} {a / AROUND:.3f} 0.5 0.2"
            )
    found += [f"vt {a / AROUND:.6f} {row / ALONG:.6f}" for row in range(ALONG + 1) for a in range(AROUND + 1)]
    for row in range(ALONG):
        found.append(f"usemtl {'red skin' if row < ALONG // 2 else 'blue'}")
        for a in range(AROUND):
            corners = ((a, row), (a, row + 1), (a + 1, row + 1), (a + 1, row))
            found.append(
                "f " + " ".join(f"{r * AROUND + c % AROUND + 1}/{r * (AROUND + 1) + c + 1}" for c, r in corners)
            )
    return found
