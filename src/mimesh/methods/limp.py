"""LIMP as an ONNX file, run by onnxruntime frame by frame. For comparison only: it works on the template's topology.

Inputs "identity" (1, V, 3) and "driving" (1, U, 3); output "result" (1, W, 3), the vertices of the template that the
network learned, in the template's order. Each input is centred on its bounding box and divided by its largest distance
from there; the result is in units of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from ..core.normalization import bbox_centre, radius
from .base import Drive, Shapes
from .npt import batch_of_one, drive_of

if TYPE_CHECKING:
    from onnxruntime import InferenceSession


@dataclass(frozen=True, eq=False)
class LIMPMethod:
    """The method `limp`: a loaded network. Results are the template's vertices, so the identity must have those."""

    rough: ClassVar[bool] = False
    template_only: ClassVar[bool] = True
    """Identities must have the vertices of the template."""
    name: str
    session: InferenceSession
    vertices: int
    """Vertices of the template."""
    target_scale: str
    """As in `NPTMethod`."""

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Check the identity's vertex count, which is all that can be checked: their order must be the template's.

        Raises:
            InputError: the identity has another count.
        """
        return drive_of(self, identity, driving)

    def shapes(self, identity: Mesh, driving: Clip) -> Shapes:
        """As `ShapeMethod.shapes`.

        Raises:
            InputError: as `prepare`.
        """
        rest = identity.vertices
        if len(rest) != self.vertices:
            raise InputError(
                f"{self.name}: expected the template of {self.vertices} vertices that it was trained on, "
                f"found an identity of {len(rest)}; it is made for comparison, choose another model"
            )
        identity_input = batch_of_one(rest)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            centred = vertices - bbox_centre(vertices)
            inputs = {"identity": identity_input, "driving": batch_of_one(centred / radius(centred))}
            return np.asarray(self.session.run(["result"], inputs)[0])[0].astype(np.float64)

        return lambda frames: map(pose, frames)
