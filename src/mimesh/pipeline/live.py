"""A session that poses an identity one driving frame at a time, as the frames of a live stream arrive.

Everything that is done once is done as for a clip (`route.find_route`); only what needs later frames is left out:
smoothing over time, planting of feet, and contacts of hands.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..core.arguments import described
from ..core.errors import InputError
from ..core.joint_tracks import JointTrack
from ..core.mesh import LARGEST, Clip, Mesh
from ..core.threads import one_thread
from ..methods.base import Drive
from ..rigs.retarget import Retarget
from .joint_route import JointRoute, report_confidence
from .node_route import NodeRoute
from .parts import PartRoute
from .report import TransferReport
from .route import Route
from .vertex_route import VertexRoute

PoseFrame = Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "V 3"]]
"""Maps the vertices of a driving frame to the identity's; both normalised."""


@dataclass(frozen=True, eq=False)
class LiveSession:
    """An identity that is ready to be posed by single frames of a driving mesh; made by `mimesh.prepare`.

    It may be used from one thread at a time. Its memory does not grow with the number of frames.

    Examples go on with the `session` of the example of `prepare`.

    Example:
        >>> session.model, session.report["driving"]["up"]
        ('mime', '+y')
    """

    identity: Mesh
    """The mesh that is moved, as it was given."""
    driving: Mesh
    """The driving mesh in the first of the frames that the session was prepared with."""
    model: str
    """Name of the model."""
    report: TransferReport
    """Facing of both meshes, and confidences and the body of models with joints, as in `ClipResult.report`."""
    notes: tuple[str, ...]
    """Lines for the user, as in `ClipResult.notes`."""
    _route: JointRoute | VertexRoute = field(repr=False)
    _pose: PoseFrame = field(repr=False)
    _shift: Float[np.ndarray, " 3"] = field(repr=False)
    """Brings the result of the first frame to the identity's position, normalised."""
    _parts: PartRoute | None = field(default=None, repr=False)
    """The parts of both meshes that are meant; None: all."""

    def pose(self, driving: ArrayLike | Mesh) -> Float[np.ndarray, "V 3"]:
        """Return the identity's vertices for one driving frame.

        The first frame that the session was prepared with gives the identity's own position; others are displaced as
        far as they are from that one, scaled as `root` says. Frames may come in any order and at any rate; none has an
        influence on the next.

        Args:
            driving: vertices (U, 3) of any real type, in the axes, unit and order of the driving mesh of the session;
                or a mesh with its triangles.

        Returns:
            Vertices (V, 3), float64, in the axes, unit and order of the identity. The array is a new one.

        Raises:
            InputError: another number of vertices or other triangles than those of the session, NaN, infinity or
                coordinates above 1e18, or all vertices at one point. The session can be used further.

        Example:
            >>> camera = [session.driving.vertices] * 3  # any source of arrays (U, 3)
            >>> [session.pose(frame).shape for frame in camera]
            [(502, 3), (502, 3), (502, 3)]
        """
        vertices = self._checked(driving)
        norms, parts = self._route.norms, self._parts
        if parts is not None and parts.driving is not None:
            vertices = vertices[parts.driving.index]
        with one_thread():
            posed = self._pose(norms[1].apply(vertices)) @ self._route.turn.T
            placed = norms[0].undo(posed + self._shift)
        return placed if parts is None else parts.placed(placed)

    def _checked(self, driving: ArrayLike | Mesh) -> Float[np.ndarray, "U 3"]:
        """Return the vertices of a frame in double precision, if they can be used."""
        name = self.driving.name
        if isinstance(driving, Mesh):
            faces = self.driving.faces
            if driving.faces is not faces and not np.array_equal(driving.faces, faces):
                raise InputError(
                    f"{name}: expected the {len(faces)} triangles that the session was prepared with, found "
                    f"{len(driving.faces)} or others; prepare a session for this mesh"
                )
            driving = driving.vertices
        if isinstance(driving, Clip):
            raise InputError(f"{name}: expected one frame, found {described(driving)}; give clip.vertices[t]")
        try:
            vertices = np.asarray(driving, np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{name}: expected numbers as vertices, found '{error}'; give an array of shape (U, 3)"
            ) from error
        expected = self.driving.vertices.shape
        if vertices.shape != expected:
            advice = "prepare a session for this mesh"
            if vertices.shape == expected[::-1]:
                advice = "give frame.T"
            elif vertices.shape[1:] == expected:
                advice = "give one frame at a time"
            raise InputError(f"{name}: expected vertices of shape {expected}, found {vertices.shape}; {advice}")
        # NaN fails the comparison, too: one pass over the array for all that can be wrong with its numbers.
        if not np.abs(vertices).max() <= LARGEST:
            bad = np.flatnonzero(~(np.abs(vertices) <= LARGEST).all(axis=1))
            raise InputError(
                f"{name}: expected finite coordinates up to {LARGEST:g}, found others in {bad.size} of {len(vertices)} "
                f"vertices of a frame (first: vertex {bad[0]}); leave this frame out"
            )
        # The first and the last vertex tell almost always: comparing all takes a tenth of a millisecond.
        if (vertices[-1] == vertices[0]).all() and not (vertices != vertices[0]).any():
            raise InputError(
                f"{name}: expected some size in every frame, found all vertices at one point; leave this frame out"
            )
        return vertices


def live_session(found: Route | PartRoute, model: str, root: str) -> LiveSession:
    """Make the session of a route."""
    parts = found if isinstance(found, PartRoute) else None
    route = found.route if isinstance(found, PartRoute) else found
    assert not isinstance(route, NodeRoute)  # `find_route` makes none for live frames
    first = route.driving_frame(0)
    if isinstance(route, VertexRoute):
        moved = _step(route.drive, first, route.names[1], route.method.name)
    else:
        scale = route.norms[1].radius / route.norms[0].radius
        moved = _follow_joints(route.retarget, first, scale if root == "keep" else None, root == "drop")

    def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
        return route.refined(moved(vertices))

    lift = route.lift_of_frames if isinstance(route, JointRoute) else None
    shift = route.shift(pose(first) @ route.turn.T, lift)
    report, notes = _report(route)
    clip = route.clip
    driving = Mesh(np.asarray(clip.vertices[0], np.float64), clip.mesh.faces, clip.mesh.name)
    if parts is not None and parts.driving is not None:
        driving = dataclasses.replace(parts.driving.whole, source=None)
    return LiveSession(found.identity, driving, model, report, notes, route, pose, shift, parts)


def _follow_joints(
    retarget: Retarget, first: Float[np.ndarray, "U 3"], across: float | None, in_place: bool
) -> PoseFrame:
    """Pose by joints: a function of the frame alone, but for where the first one was; see `Retarget.posed_joints`."""

    def joints(vertices: Float[np.ndarray, "U 3"]) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, " 3"]]:
        rotation, positions = retarget.motion.pose(0, vertices)
        # The frame rate is for smoothing, feet and contacts, which are left out.
        posed = retarget.posed_joints(JointTrack(rotation[None], positions[None], 1.0), across, False, False, False)
        return posed.rotation[0], posed.root[0]

    start = joints(first)[1]

    def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
        rotation, root = joints(vertices)
        return retarget.character.posed(rotation, np.array([start[0], root[1], start[2]]) if in_place else root)

    return pose


def _step(drive: Drive, first: Float[np.ndarray, "U 3"], name: str, model: str) -> PoseFrame:
    """Run a drive frame by frame. It gets the first frame first, because that may fix the size of all results."""
    waiting: deque[np.ndarray] = deque()

    def frames() -> Iterator[np.ndarray]:
        while True:
            if not waiting:
                raise InputError(
                    f"{name}: expected a model that makes each frame from that frame alone, found {model}, which needs "
                    "later ones; choose mime, or move a recorded clip with animate"
                )
            yield waiting.popleft()

    def started() -> Iterator[np.ndarray]:
        waiting.clear()
        waiting.append(first)
        results = drive(frames())
        next(results)
        return results

    results = started()

    def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
        nonlocal results
        waiting.append(vertices)
        try:
            return next(results)
        except BaseException:  # an iterator that has raised is at its end
            results = started()
            raise

    return pose


def _report(route: JointRoute | VertexRoute) -> tuple[TransferReport, tuple[str, ...]]:
    """Return what is known of both meshes before the first frame, and notes for the user."""
    report: dict = dict(zip(("identity", "driving"), route.facings, strict=True))
    notes: tuple[str, ...] = ()
    if isinstance(route, JointRoute):
        report["body"] = route.mime.body
        notes += report_confidence(route.retarget, report, route.names)
    return cast(TransferReport, report), notes + route.all_notes(True)
