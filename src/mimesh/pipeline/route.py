"""Choose the way from an identity and a clip to a result: by copied or matched joints, a reference, or a model.

The same skeleton in both files is copied; rigs of other creatures are matched with each other; two shapes of one mesh
that is no body are moved by deformation transfer. Everything else is done by `mime`, which moves joints, or by a method
that moves vertices.
"""

from __future__ import annotations

from ..core.errors import InputError
from ..core.mesh import Clip, Mesh, same_mesh
from ..methods.base import Method
from ..mime.model import Mime
from .creatures import matched_creatures
from .file_rigs import Rigs, read_rigs
from .joint_route import JointRoute, joint_route
from .look import OTHER, finds_joints, looks_like
from .marked_mesh import MarkedFrame, marked_frame
from .node_route import NodeRoute
from .options import Hints, MotionOptions
from .placed import check_identity, first_frame
from .same_mesh import ReferenceFrame, nearest_frame
from .vertex_route import NamedMethod, VertexRoute, reference_route, vertex_route

Route = JointRoute | VertexRoute | NodeRoute
"""An identity and a clip after all work that is done once: `play` makes the result, `frame` one frame of it."""
Model = Mime | NamedMethod | Method
"""What moves the identity where its file does not say."""


def find_route(
    identity: Mesh, clip: Clip, model: Model, hints: Hints, options: MotionOptions, live: bool = False
) -> Route:
    """Choose the way to move a mesh, and do all work that is done once, without refinement.

    Args:
        live: frames come later, one by one, and are vertices alone.

    Raises:
        InputError: an axis, the model, its options or the corrections cannot be used.
    """
    check_identity(identity)
    if hints.body == OTHER and hints.corrections.given:
        raise InputError(
            "--joints: expected people or four-legged animals, found --body other, which has no joints to correct; "
            "leave one of the two out, or ignore the files with --no-joints"
        )
    mime = model if isinstance(model, Mime) else None
    rigs = read_rigs(identity, clip, hints, copy=not live and not options.changes_motion)
    matched = None
    if not live and hints.rig == "own" and rigs.copied is None and not hints.corrections.given:
        matched = matched_creatures(identity, clip, rigs, mime, hints)
    if (rigs.only_copied or matched is not None) and options.smooth > 0:
        raise InputError(
            f"--smooth: expected the rig of a person, found another one in {identity.name}; leave this option out"
        )
    if matched is not None:
        return NodeRoute(identity, clip, matched.axes, rigs, matched)
    reference = None if mime is None else _reference(identity, clip, rigs, mime, hints)
    if reference is not None:
        return reference_route(identity, clip, reference, hints, options)
    if rigs.copied is not None:
        return NodeRoute(identity, clip, rigs.axes(hints.axes), rigs, None)
    if isinstance(model, Mime):
        return joint_route(identity, clip, model, hints, rigs)
    return vertex_route(identity, clip, model, hints, options, rigs)


def _reference(identity: Mesh, clip: Clip, rigs: Rigs, mime: Mime, hints: Hints) -> ReferenceFrame | MarkedFrame | None:
    """Find the frame of a driving that has about the pose of an identity that is no body; None where it may be one."""
    if rigs.copied is not None or hints.corrections.given or hints.body not in ("auto", OTHER):
        return None
    if not finds_joints(mime):
        return None
    if hints.body == OTHER:
        same = same_mesh(identity, clip.mesh)
        return nearest_frame(identity, clip) if same else marked_frame(identity, clip, hints.axes)
    if rigs.bodies != (None, None) or len(clip) == 1 or not same_mesh(identity, clip.mesh):
        return None
    if looks_like(mime, identity, hints.axes[:2]) or looks_like(mime, first_frame(clip), hints.axes[2:]):
        return None
    return nearest_frame(identity, clip)
