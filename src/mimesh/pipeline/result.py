"""Results of `transfer` and `animate`: the moved identity with its report; they can be saved and shown."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from jaxtyping import Float, Int

from ..bodies.joint_names import without_fingers
from ..core.animated_rig import AnimatedRig
from ..core.arguments import public
from ..core.errors import InputError
from ..core.frame_buffer import LazyFrames, Progress
from ..core.mesh import Clip, Mesh, merged_mesh, same_colors
from ..io import joints_file, refuse_vrm, save_clip, save_mesh
from ..io.atomic import scratch_folder, written
from ..io.formats import JOINTED
from .report import MeshReport, SavedClip, TransferReport, saved_clip

if TYPE_CHECKING:
    from ..io.gltf.own_animation import OwnAnimation
    from ..view.pack import MotionLimits, Panel
    from ..view.page import Download

Precision = type[np.floating]
"""Type of the vertices of a result."""
LARGEST_DOWNLOAD = 8 * 2**20
"""Bytes up to which a page contains the file for download; to larger files it links."""


class Timer(dict[str, float]):
    """Wall time (seconds) that each step has taken so far: step -> seconds."""

    def __init__(self) -> None:
        super().__init__(dict.fromkeys(("load", "prepare", "drive", "refine", "write"), 0.0))

    @contextlib.contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Add the wall time of the block to that of the step."""
        begin = time.perf_counter()
        yield
        self[name] += time.perf_counter() - begin


class _Playable(Protocol):
    """Base of both kinds of results: an offline page that shows identity, driving and result side by side."""

    model: str
    report: TransferReport
    notes: tuple[str, ...]
    mesh: Mesh
    identity: Mesh | None
    skeleton: AnimatedRig | None

    def _distinct(self) -> tuple[LazyFrames, Int[np.ndarray, " V"] | None]:
        """Return the frames of the result, each position that vertices share once, and the number of each vertex's.

        Without such numbers (None) the frames are those of all vertices.
        """
        ...

    @property
    def driving_clip(self) -> Clip | None:
        """The driving mesh or clip as a clip; None where the result does not know it."""
        ...

    @property
    def joints(self) -> dict[str, Float[np.ndarray, " 3"]] | None:
        """Joint -> position (3,) found on the identity, in axes, unit and position of its file; None without joints.

        Those of fingers are left out: all others can be corrected and passed to `transfer`.

        Example:
            >>> moved_knee = {"LeftLeg": result.joints["LeftLeg"] + [0.02, 0, 0]}  # Hints(joints=moved_knee)
        """
        rig = self.skeleton
        if rig is None:
            return None
        person = {name: j for j, name in enumerate(rig.names)} if rig.person is None else rig.person
        return without_fingers({name: rig.rig.joints[j] for name, j in person.items()})

    def panels(self, most: int | None = None) -> list[Panel] | None:
        """Return identity, driving and result with the axes of the report, for the player; None without the inputs.

        Args:
            most: frames of a longer clip, evenly spread, that are shown; others are not made. None: all.

        Raises:
            InputError: fewer than one frame.

        Example:
            >>> [panel.role for panel in result.panels()]
            ['identity', 'driving', 'result']
        """
        from ..view.pack import Panel

        if most is not None and most < 1:
            raise InputError(f"most: expected 1 frame or more, found {most}; leave it out for all")
        identity, driving = self.identity, self.driving_clip
        if identity is None or driving is None:
            return None

        def panel(name: str, clip: Clip, axes: MeshReport) -> Panel:
            return Panel(name, clip, up=axes["up"], front=axes["front"])

        step = 1 if most is None else -(-len(driving) // most)
        frames, group = self._distinct()
        shown = merged_mesh(identity, group)
        moved = dataclasses.replace(shown, vertices=frames.first())  # the page makes normals of its own
        result = Clip(moved, frames.every(step), driving.fps / step)
        result = panel("result", result, self.report["identity"])
        return [
            panel("identity", Clip.still(shown), self.report["identity"]),
            panel("driving", driving, self.report["driving"]).with_every(step),
            dataclasses.replace(result, every=step, whole=len(driving)),
        ]

    @public
    def player(
        self,
        path: str | Path,
        *,
        output: str | Path | None = None,
        title: str | None = None,
        motion: MotionLimits | None = None,
    ) -> Path:
        """Write an HTML page that plays identity, driving and result; it needs no other file and no network.

        Args:
            path: the page to write.
            output: the file this result was saved to; a button of the page downloads it, as .glb where possible.
            title: title of the page; by default the name of the path up to its first dot.
            motion: largest number of frames and size of the motion; None: as the size of the page allows.

        Returns:
            The path of the page.

        Raises:
            InputError: the result has no identity and driving, or the path cannot be written.

        Example:
            >>> page = result.player("hero.html", title="Hero")
        """
        from ..view.pack import ANY_LENGTH
        from ..view.page import write_player

        path, motion = Path(path), motion or ANY_LENGTH
        shown = self.panels(motion.frames)
        if shown is None:
            raise InputError(
                f"{path}: expected a result of transfer or animate, found one without its inputs; run it again"
            )
        title = title or path.name.split(".")[0]
        download = None if output is None else self._download(Path(output))
        return write_player(
            path, shown, title=title, download=download, model=self.model, notes=self.notes, motion=motion
        )

    def _repr_html_(self) -> str | None:
        """Show the player in a notebook."""
        from ..view.page import notebook_frame

        shown = self.panels()
        return None if shown is None else notebook_frame(shown, model=self.model, notes=self.notes)

    def _download(self, output: Path) -> Download:
        """Return the .glb that was written, else one made of the result, else a link to the output."""
        from ..view.page import Download

        if output.suffix.lower() == ".glb":
            file = written(output)
            content = file.read_bytes() if file.stat().st_size <= LARGEST_DOWNLOAD else None
            return Download(output.name, content)
        frames = len(self.frames) if isinstance(self, ClipResult) else 1
        if 4 * (frames * self.mesh.vertices.size + self.mesh.faces.size) > LARGEST_DOWNLOAD:
            return Download(output.name, None)
        with scratch_folder() as folder:
            path = folder / "result.glb"
            if isinstance(self, ClipResult):
                save_clip(self.clip, path)
            else:
                save_mesh(self.mesh, path)
            return Download(f"{output.stem}.glb", path.read_bytes())


@dataclass(frozen=True, eq=False)
class Result(_Playable):
    """The identity in the driving's pose, in the identity's axes, unit and position; made by `mimesh.transfer`.

    Examples go on with the `result` of the example of `transfer`.

    Example:
        >>> result.mesh.vertices.shape, result.notes
        ((502, 3), ())
        >>> result.report["identity"]["up"], result.skeleton.names[0]
        ('+y', 'Hips')
        >>> sorted(result.seconds)
        ['drive', 'load', 'prepare', 'refine', 'write']
    """

    mesh: Mesh
    """The identity with other vertices (V, 3)."""
    model: str
    """Name of the model."""
    seconds: Timer
    """Wall time in seconds of each step: load, prepare, drive, refine, write."""
    report: TransferReport
    """What was measured and found, see `TransferReport`."""
    notes: tuple[str, ...] = ()
    """Lines for the user: what may be wrong with the result, and what to do."""
    identity: Mesh | None = field(default=None, repr=False)
    """The mesh that was moved, to be shown beside the result; without it there is no page."""
    driving: Mesh | None = field(default=None, repr=False)
    """The mesh whose pose was taken, for the same."""
    skeleton: AnimatedRig | None = field(default=None, repr=False)
    """Joints, skinning weights and pose of the identity, if the model has joints."""
    driving_joints: dict[str, Float[np.ndarray, " 3"]] | None = field(default=None, repr=False)
    """Joint -> position found on the driving mesh, in its file's axes, unit and position, if the model has joints."""
    own: OwnAnimation | None = field(default=None, repr=False)
    """The pose of the bones of the identity's own file, if it has a rig that is used."""

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices of the result, in the axes, unit and order of the identity."""
        return self.mesh.vertices

    def _distinct(self) -> tuple[LazyFrames, Int[np.ndarray, " V"] | None]:
        group = None if self.skeleton is None else same_colors(self.mesh, self.skeleton.group)
        return LazyFrames.stored(merged_mesh(self.mesh, group).vertices[None]), group

    @property
    def driving_clip(self) -> Clip | None:
        """The driving mesh as a clip of one frame; None where the result does not know it."""
        return None if self.driving is None else Clip.still(self.driving)

    @public
    def save(self, path: str | Path) -> Path:
        """Write the mesh in the format of the suffix; the identity's own suffix keeps all contents of its file.

        A rigged glTF identity that moved on its own bones stays rigged: its bones are in the pose. If its file has
        animations, the pose comes first among them, because programs play the first one.

        Args:
            path: the file; folders that do not exist are made.

        Returns:
            The path.

        Raises:
            InputError: a format that cannot be written, or a path that cannot be written to.

        Example:
            >>> path = result.save("posed.obj")
        """
        path = Path(path)
        with self.seconds.step("write"):
            if self.own is not None and path.suffix.lower() in JOINTED:
                from ..io.gltf.own_animation import write_own_pose

                with joints_file(path, animated=False) as temporary:
                    write_own_pose(self.own, temporary)
            else:
                save_mesh(self.mesh, path)
        return path


@dataclass(frozen=True, eq=False)
class ClipResult(_Playable):
    """The identity with the driving clip's motion, in the identity's axes, unit and position; made by `mimesh.animate`.

    Examples go on with `moving`, the result of the example of `animate`.

    Example:
        >>> moving.clip.vertices.shape, moving.fps
        ((4, 502, 3), 10.0)
        >>> moving.skeleton.rotation.shape  # (T, J, 3, 3)
        (4, 31, 3, 3)
    """

    mesh: Mesh
    """The identity in the first frame."""
    frames: LazyFrames
    """The identity's vertices (V, 3) in each of T frames, in single precision unless it is far from the origin (a note
    tells). Those of models with joints are made when they are asked for: `frames.at([0, 10])` makes two of them."""
    fps: float
    """Frames a second."""
    model: str
    """Name of the model."""
    seconds: Timer
    """Wall time in seconds of each step: load, prepare, drive, refine, write."""
    report: TransferReport
    """What was measured and found, see `TransferReport`."""
    notes: tuple[str, ...] = ()
    """Lines for the user: what may be wrong with the result, and what to do."""
    skeleton: AnimatedRig | None = None
    """Joints, skinning weights and motion of the identity, if the model has joints."""
    identity: Mesh | None = field(default=None, repr=False)
    """The mesh that was moved, to be shown beside the result; without it there is no page."""
    driving: Clip | None = field(default=None, repr=False)
    """The clip whose motion was taken, for the same; its frames stay in memory, or on disk if they are many."""
    driving_joints: dict[str, Float[np.ndarray, " 3"]] | None = field(default=None, repr=False)
    """Joint -> position found in the first driving frame, in its file's axes, unit and position."""
    own: OwnAnimation | None = field(default=None, repr=False)
    """The motion on the bones of the identity's own file, if it has a rig that is used."""

    @cached_property
    def clip(self) -> Clip:
        """The identity in all frames: `clip.vertices` is (T, V, 3). It is made when it is first asked for, and kept."""
        return Clip(self.mesh, self.frames.every(1), self.fps)

    def _distinct(self) -> tuple[LazyFrames, Int[np.ndarray, " V"] | None]:
        group = same_colors(self.mesh, self.frames.group)
        return (self.frames if group is None else self.frames.distinct), group

    @property
    def driving_clip(self) -> Clip | None:
        """The driving clip; None where the result does not know it."""
        return self.driving

    @public
    def save(self, path: str | Path, *, progress: Progress | None = None) -> SavedClip:
        """Write the clip in the format of the suffix: a file, a movie, or without a suffix a folder of meshes.

        A .glb or .gltf has a morph target for each frame; `save_skinned` writes joints, as `mimesh animate` does. A
        .vrma has joints alone.

        Args:
            path: the file or folder.
            progress: is called with the frames done and the frames in all.

        Returns:
            The path.

        Raises:
            InputError: a format that cannot contain a clip, or a path that cannot be written to.

        Example:
            >>> moving.save("walking.pc2").name
            'walking.pc2'
        """
        from ..view.movie import write_clip

        refuse_vrm(path)
        if Path(path).suffix.lower() == ".vrma":
            return self.save_skinned(path)
        with self.seconds.step("write"):
            clip = self.__dict__.get("clip") or Clip(self.mesh, self.frames.every(1, progress), self.fps)
            write_clip(clip, Path(path), progress=progress)
        return saved_clip(path, {})

    @public
    def save_skinned(
        self,
        path: str | Path,
        *,
        names: str = "own",
        root_bone: bool = False,
        rest: str = "file",
        fps: float | None = None,
    ) -> SavedClip:
        """Write a .glb, .gltf or .fbx of the identity at rest with joints, four weights a vertex and joint rotations.

        Such files are small for any length of clip, and game engines read them; see `skinned.save_skinned`, which also
        writes several results to one file. A .vrma has the motion of the humanoid bones of VRM alone.

        Args:
            path: the file.
            names: names and hierarchy of the bones, as in "mixamo", "unreal", "vrm", "godot", "rigify"; "own"
                keeps them. Bones of the identity's own rig are renamed where they are.
            root_bone: add a bone on the ground that carries the displacement over it; the hips keep the rest. The
                identity's own rig gets it above all joints, or has such a bone already.
            rest: pose that the mesh is bound in: that of the identity's "file", "T" or "A"; own rigs have the file's.
            fps: frame rate of the file, sampled from this result's; None keeps it.

        Returns:
            The path, and how far the file is from the frames ("skinned_deviation" and others).

        Raises:
            InputError: the model has no joints, or not those of a person; no such names, pose or rate.

        Example:
            >>> saved = moving.save_skinned("walking.glb", names="mixamo")
            >>> saved.deviations[0]["skinned_deviation"] < 0.1  # share of the size
            True
        """
        from ..core.options import Layout
        from .skinned import save_skinned

        return save_skinned([self], path, layout=Layout(names, root_bone, rest, fps))
