"""Move an identity by values of its file's nodes: copied from the same skeleton, or following matched joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from jaxtyping import Float

from ..core.frame_buffer import LazyFrames, Progress
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..core.options import MotionOptions
from ..io.beside import missing_images, missing_images_notes
from ..io.gltf.edit import GltfSource
from ..io.gltf.own_animation import OwnAnimation
from .creatures import MatchedCreatures
from .file_rigs import Rigs
from .known import Axes
from .placed import Moved, first_frame, surface_report
from .report import TransferReport, facing, torn_note
from .result import Timer


@dataclass(frozen=True, eq=False)
class NodeRoute:
    """An identity whose nodes get values from the driving's, and a clip."""

    identity: Mesh
    clip: Clip
    axes: Axes
    """Up and front of both, for the report, from which pictures are drawn."""
    rigs: Rigs
    """With the values that are copied, where no joints are matched."""
    matched: MatchedCreatures | None

    def with_refinement(self, refine: bool | None) -> NodeRoute:
        """Return this route: results of nodes are not refined."""
        return self

    def frame(self, t: int) -> Float[np.ndarray, "V 3"]:
        """Make the identity's vertices in frame t only, without MotionOptions."""
        return next(self._unchanged.vertices(np.array([t])))

    def joints(self, t: int) -> None:
        """Return the joints of both meshes: none that have roles."""

    def play(
        self,
        timer: Timer,
        options: MotionOptions,
        progress: Progress | None = None,
        dtype: type[np.floating] = np.float64,
    ) -> Moved:
        """Animate the nodes of the identity's file, and report; nothing is planted."""
        identity, clip = self.identity, self.clip
        with timer.step("drive"):
            own = self._animation(options.root)
            if progress is not None:
                progress(len(clip), len(clip))
            moved = LazyFrames((own.frames, len(identity.vertices)), own.vertices, np.dtype(dtype))
            norms = Normalization.fit(identity, *self.axes[:2]), Normalization.fit(first_frame(clip), *self.axes[2:])
            report = surface_report(identity, moved, (facing(norms[0]), facing(norms[1])))
        facts = {"copied": True} if self.matched is None else {"copied": False, "match": self.matched.facts()}
        report |= {"rig": "own", **facts, "fingers": [], "foot_skate": None, "foot_skate_driving": None}
        notes = () if self.matched is None else self.matched.notes
        notes += torn_note(report, identity.name, found=False) + missing_images_notes(missing_images(identity))
        return Moved(moved, None, own, cast(TransferReport, report), notes)

    def _animation(self, root: str = "scale") -> OwnAnimation:
        """Compute the values of the identity's nodes in all frames; `root` is for matched joints (`MotionOptions`)."""
        source, name, length = self.identity.source, self.clip.mesh.name, len(self.clip)
        assert isinstance(source, GltfSource)
        if self.matched is not None:
            return OwnAnimation(source, name, self.matched.tracks(root), self.clip.fps, length, {})
        assert self.rigs.copied is not None
        person = {} if self.rigs.identity is None else self.rigs.identity.person
        tracks, keys = self.rigs.copied.tracks, self.rigs.copied.keys
        return OwnAnimation(source, name, tracks, self.clip.fps, length, person, keys=keys)

    @cached_property
    def _unchanged(self) -> OwnAnimation:
        """The animation with the path scaled, which single frames are made of."""
        return self._animation()
