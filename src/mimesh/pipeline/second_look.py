"""Look a second time at meshes that do not look like the body that they were taken for, by fits of all bodies.

The first choice (`body_choice.py`) compares one prediction of each network. A fit says more, and takes longer: a sheep
that is taken for a person fits no person, and a chair fits neither.
"""

from __future__ import annotations

from ..core.errors import RefusedMeshError
from ..core.mesh import Mesh
from ..methods.base import BodyMethod, Method, RigMethod
from ..methods.confidence import IF_IT_IS, MAX_SPREAD, Confidence
from .matched_rigs import predicted_body
from .rigs import Axes, Rigs

KINDS = {"human": "a person", "quadruped": "a four-legged animal"}
PLURAL = {"human": "people", "quadruped": "four-legged animals"}
"""What meshes with each body are called in messages."""
FITS = 0.0
"""Largest `Confidence.other_kind` of a mesh that another body is found on. It is below MAX_OTHER_KIND, so that no mesh
changes its kind for a trifle."""
UpFront = tuple[str | None, str | None]
"""Up and front of a mesh as the user gave them."""


def second_look(
    method: BodyMethod, taken: str, mesh: Mesh, axes: UpFront, confidence: Confidence | None = None
) -> str | None:
    """Say which body a mesh has: the one that it was taken for, if that fits, else another one that does, else None.

    Args:
        confidence: of the body that it was taken for, if that was fitted already.
    """
    first = _fitted(method, taken, mesh, axes) if confidence is None else confidence
    if first is None or not first.is_other_kind:
        return taken
    for body in method.bodies:
        other = None if body == taken else _fitted(method, body, mesh, axes)
        if other is not None and other.other_kind < FITS and other.prediction_spread <= MAX_SPREAD:
            return body
    return None


def body_after_all(
    methods: tuple[Method, Method],
    rigs: Rigs,
    meshes: tuple[Mesh, Mesh],
    axes: Axes,
    confidences: tuple[Confidence | None, Confidence | None] | None,
) -> str | None:
    """Return the body that both meshes have after all, where it is not the one that they were taken for.

    Args:
        methods: one that knows all bodies, and that of the body that was fitted to both.
        confidences: of these fits.

    Raises:
        RefusedMeshError: one mesh has the one body, the other another one.
    """
    method, used = methods
    if not (isinstance(method, BodyMethod) and isinstance(used, BodyMethod)) or confidences is None:
        return None
    doubted = [confidence is not None and confidence.is_other_kind for confidence in confidences]
    if any(body is not None for body in rigs.bodies) or not any(doubted):
        return None
    found = [
        second_look(method, used.body, mesh, of_mesh, confidence) if confidence else used.body
        for mesh, of_mesh, confidence in zip(meshes, (axes[:2], axes[2:]), confidences, strict=True)
    ]
    known = {body for body in found if body is not None}
    if len(known) > 1:
        raise RefusedMeshError(different_kinds(found, meshes))
    # Where one is of the kind that it was taken for and the other one of none, a note says so.
    return next(iter(known - {used.body}), None)


def different_kinds(found: list[str | None], meshes: tuple[Mesh, Mesh]) -> str:
    """Say which kinds two meshes are of, and what helps."""
    if None in found:
        odd, other = (0, 1) if found[0] is None else (1, 0)
        body = found[other]
        beside = f", as {meshes[other].name} is {KINDS[body]}" if body else ""
        return (
            f"{meshes[odd].name}: expected a person or a four-legged animal{beside}, found a shape that looks like "
            f"neither, as far as can be told; {IF_IT_IS}"
        )
    first, second = (KINDS[body] for body in found if body is not None)
    return (
        f"{meshes[0].name} is taken for {first}, and {meshes[1].name} for {second}: expected two of a kind; give "
        "another driving, or --body human or quadruped if one of the two is taken for the wrong one"
    )


def _fitted(method: BodyMethod, body: str, mesh: Mesh, axes: UpFront) -> Confidence | None:
    """Fit a body to a mesh; None if the network does not fit one."""
    network = method.of_body(body)
    if not isinstance(network, RigMethod):
        return None
    confidence = predicted_body(network, mesh, axes)[2]
    return confidence if confidence.fitted else None
