"""What transfer() and animate() give."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from ..core.rig import Skeleton


@dataclass(frozen=True, eq=False)
class Result:
    """The identity in the driving's pose, in the identity's own axes, unit and place."""

    mesh: Mesh
    model: str
    seconds: dict[str, float]
    """Wall time of each step: load, prepare, drive, refine, write."""
    report: dict
    notes: tuple[str, ...] = ()
    identity: Mesh | None = field(default=None, repr=False)
    """What was moved and what it imitated, to be shown beside the result; None leaves the result without a page."""
    driving: Mesh | None = field(default=None, repr=False)

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        return self.mesh.vertices

    def save(self, path: str | Path) -> Path:
        """Write the mesh in the format of the suffix; the identity's own suffix keeps all that its file had."""
        from ..io import save_mesh

        with timed(self.seconds, "write"):
            save_mesh(self.mesh, Path(path))
        return Path(path)

    def player(self, path: str | Path) -> Path:
        """Write an HTML page that shows identity, driving and result; it needs nothing beside it, and no network.

        Raises:
            InputError: a result that does not know its identity and driving, or a path that cannot be written.
        """
        from ..player.page import write_result

        return write_result(self, Path(path))

    def _repr_html_(self) -> str | None:
        from ..player.page import notebook_frame

        return notebook_frame(self)


@dataclass(frozen=True, eq=False)
class ClipResult:
    """The identity moving as the driving clip does, in the identity's own axes, unit and place."""

    clip: Clip
    model: str
    seconds: dict[str, float]
    """Wall time of each step: load, prepare, drive, refine, write."""
    report: dict
    notes: tuple[str, ...] = ()
    skeleton: Skeleton | None = None
    """What moved the identity, if the model has joints."""
    identity: Mesh | None = field(default=None, repr=False)
    """What was moved and what it imitated, frame by frame; the driving's frames stay in memory, or on disk if many."""
    driving: Clip | None = field(default=None, repr=False)

    @property
    def fps(self) -> float:
        return self.clip.fps

    def save(self, path: str | Path, blendshapes: int | None = None, progress: Progress | None = None) -> Path:
        """Write the clip in the format of the suffix: a file, a movie, or a folder of meshes where it has none.

        `blendshapes` makes a .glb or .gltf of so many morph targets in all instead of one a frame; `report` then says
        how far the farthest vertex is from its frame, over the mesh's size.
        """
        from ..tools.convert import write_clip

        with timed(self.seconds, "write"):
            deviation = write_clip(self.clip, Path(path), blendshapes=blendshapes, progress=progress)
        if deviation is not None:
            self.report["blendshapes_deviation"] = deviation
        return Path(path)

    def player(self, path: str | Path) -> Path:
        """Write an HTML page that plays identity, driving and result; it needs nothing beside it, and no network.

        Raises:
            InputError: a result that does not know its identity and driving, or a path that cannot be written.
        """
        from ..player.page import write_result

        return write_result(self, Path(path))

    def _repr_html_(self) -> str | None:
        from ..player.page import notebook_frame

        return notebook_frame(self)

    def save_skinned(self, path: str | Path) -> Path:
        """Write a .glb or .gltf of the identity at rest with joints, four weights a vertex and an animation of turns.

        Small whatever the clip's length, and what game engines take; `report` then says how far it is from the frames.

        Raises:
            InputError: the model has no joints.
        """
        from ..io import save_skinned

        if self.skeleton is None:
            raise InputError(f"--skinned: expected a model with joints (mime), found {self.model}; choose it with -m")
        with timed(self.seconds, "write"):
            save_skinned(self.skeleton, self.fps, Path(path))
        self.report["skinned_deviation"] = self.skeleton.deviation(self.clip.vertices)
        return Path(path)


def no_time_yet() -> dict[str, float]:
    return dict.fromkeys(("load", "prepare", "drive", "refine", "write"), 0.0)


@contextlib.contextmanager
def timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    """Add the wall time of the block to `seconds[step]`."""
    begin = time.perf_counter()
    yield
    seconds[step] += time.perf_counter() - begin
