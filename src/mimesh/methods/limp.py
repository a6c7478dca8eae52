"""LIMP as an ONNX file, run by onnxruntime frame by frame: for comparison, on its template's vertices alone.

Inputs "identity" (1, V, 3) and "driving" (1, U, 3); output "result" (1, W, 3), the vertices of the template that the
network learned, in the template's order. Each input is centred on its bounding box and divided by its largest distance
from there; the result is in units of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.geometry import edges
from ..core.mesh import Clip, Mesh
from ..core.normalization import bbox_centre, radius
from .base import Drive
from .npt import EdgeLengths, batch_of_one
from .root_motion import with_root_motion

if TYPE_CHECKING:
    from onnxruntime import InferenceSession


@dataclass(frozen=True, eq=False)
class LIMPMethod:
    """A loaded network. Its results are the template's vertices, so that is what an identity must be."""

    rough: ClassVar[bool] = False
    template_only: ClassVar[bool] = True
    """Identities must have the vertices of the template."""
    name: str
    session: InferenceSession
    vertices: int
    """Of the template."""
    target_scale: str
    """As Network's."""

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Only the identity's count can be checked here: that its vertices are the template's is the caller's word.

        Raises:
            InputError: the identity has another count.
        """
        still = identity.vertices
        if len(still) != self.vertices:
            raise InputError(
                f"{self.name}: expected the template of {self.vertices} vertices that it was trained on, "
                f"found an identity of {len(still)}; it is made for comparison, choose another model"
            )
        lengths = EdgeLengths.of(still, edges(identity.faces))
        person = batch_of_one(still)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            centred = vertices - bbox_centre(vertices)
            inputs = {"identity": person, "driving": batch_of_one(centred / radius(centred))}
            result = np.asarray(self.session.run(["result"], inputs)[0])[0].astype(np.float64)
            return lengths.resized(result, still) if self.target_scale == "truth" else result

        def drive(frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
            return with_root_motion(frames, pose, driving.mesh.name)

        return drive
