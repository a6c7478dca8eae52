"""Choose the way from an identity and a clip to a result: by copied or matched joints, a reference, or a model.

The same skeleton in both files is copied; rigs of other creatures are matched with each other; two shapes of one mesh
that is no body are moved by deformation transfer. Everything else is done by `mime`, which moves joints, or by a method
that moves vertices.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, TypeAlias

from ..core.errors import InputError, option
from ..core.mesh import Clip, Mesh, same_mesh
from ..core.options import MotionOptions
from ..io.formats import may_have_joints
from ..methods.base import Method
from ..mime.model import Mime
from .file_rigs import Rigs, read_rigs
from .joint_route import JointRoute, joint_route
from .known import Known
from .look import OTHER, finds_joints, looks_like
from .parts import PartRoute, find_part
from .placed import check_identity, first_frame

if TYPE_CHECKING:
    from .node_route import NodeRoute
    from .vertex_route import NamedMethod, ReferenceFrame, VertexRoute

# All but the usual way are imported when they are taken.
Route: TypeAlias = "JointRoute | VertexRoute | NodeRoute"
"""An identity and a clip after all work that is done once: `play` makes the result, `frame` one frame of it."""
Model: TypeAlias = "Mime | NamedMethod | Method"
"""What moves the identity where its file does not say."""


def find_route(
    identity: Mesh, clip: Clip, model: Model, known: Known, options: MotionOptions, live: bool = False
) -> Route | PartRoute:
    """Choose the way to move a mesh, and do all work that is done once, without refinement.

    Args:
        live: frames come later, one by one, and are vertices alone.
    """
    mine, theirs = find_part(identity, known.parts[0]), find_part(clip.mesh, known.parts[1], "driving_part")
    if mine is None and theirs is None:
        return _route(identity, clip, model, known, options, live)
    corrections = known.corrections.of_part(None if theirs is None else theirs.index)
    identity, clip = identity if mine is None else mine.mesh, clip if theirs is None else theirs.clip(clip)
    known = dataclasses.replace(known, corrections=corrections)
    return PartRoute(_route(identity, clip, model, known, options, live), mine, theirs)


def _route(identity: Mesh, clip: Clip, model: Model, known: Known, options: MotionOptions, live: bool) -> Route:
    """Choose the way to move a mesh that is no part of another."""
    check_identity(identity)
    if known.body == OTHER and known.corrections.given:
        raise InputError(
            f"{option('joints')}: expected people or four-legged animals, found {option('body', 'other')}, which has "
            "no joints to correct; leave one of the two out, or the joints out"
        )
    mime = model if isinstance(model, Mime) else None
    rigs = read_rigs(identity, clip, known, copy=not live and not options.changes_motion)
    known = known.with_heading(clip, None if mime is None else rigs.driving)
    matched = None
    both = clip.skeleton is not None and may_have_joints(identity)
    if both and not live and known.rig == "own" and rigs.copied is None and not known.corrections.given:
        from .node_route import matched_creatures

        matched = matched_creatures(identity, clip, rigs, mime, known)
    if (rigs.only_copied or matched is not None) and options.smooth > 0:
        raise InputError(
            f"{option('smooth')}: expected the rig of a person, found another one in {identity.name}; leave this "
            "option out"
        )
    if matched is not None:
        from .node_route import NodeRoute

        return NodeRoute(identity, clip, matched.axes, rigs, matched)
    reference = None if mime is None else _reference(identity, clip, rigs, mime, known)
    if reference is not None:
        from .vertex_route import reference_route

        return reference_route(identity, clip, reference, known, options)
    if rigs.copied is not None:
        from .node_route import NodeRoute

        return NodeRoute(identity, clip, rigs.axes(known.axes), rigs, None)
    if isinstance(model, Mime):
        return joint_route(identity, clip, model, known, rigs)
    from .vertex_route import vertex_route

    return vertex_route(identity, clip, model, known, options, rigs)


def _reference(identity: Mesh, clip: Clip, rigs: Rigs, mime: Mime, known: Known) -> ReferenceFrame | None:
    """Find the frame of a driving that has about the pose of an identity that is no body; None where it may be one."""
    if rigs.copied is not None or known.corrections.given or known.body not in ("auto", OTHER):
        return None
    if not finds_joints(mime):
        return None
    if known.body != OTHER and (rigs.bodies != (None, None) or len(clip) == 1 or not same_mesh(identity, clip.mesh)):
        return None
    from .vertex_route import nearest_frame

    if known.body == OTHER:
        return nearest_frame(identity, clip)
    shown = ((identity, known.axes[:2]), (first_frame(clip), known.axes[2:]))
    recognised = any(body for mesh, axes in shown for body in looks_like(mime, mesh, axes))
    return None if recognised else nearest_frame(identity, clip)
