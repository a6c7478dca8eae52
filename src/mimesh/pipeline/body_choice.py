"""Choose the shipped body whose joints both meshes have: that of a person, or that of a four-legged animal.

A rig in a file says it. Of other meshes both networks predict the joints once, and the one with the more decided
skinning weights is taken.
"""

from __future__ import annotations

from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.normalization import Normalization
from ..methods.base import BodyMethod, Method
from ..methods.find import NETWORK_OF_BODY
from .orientation import normalised
from .rigs import Rigs

BODIES = ("auto", *NETWORK_OF_BODY)
"""Choices of `--body`."""
KINDS = {"human": "a person", "quadruped": "a four-legged animal"}
"""What a mesh with each body is called in messages."""
MARGIN = 0.1
"""Largest entropy of skinning weights (nats) beyond the human network's at which the other one is still not taken."""


def check_body(body: str) -> None:
    """Raise InputError if a choice is none of BODIES."""
    if body not in BODIES:
        raise InputError(f"--body: expected one of {', '.join(BODIES)}, found {body!r}; choose one of them")


def with_body(
    method: Method, asked: str, rigs: Rigs, meshes: tuple[Mesh, Mesh], norms: tuple[Normalization, Normalization]
) -> Method:
    """Return the method for the body of both meshes; most have one.

    Args:
        asked: one of BODIES.
        meshes: the identity and the driving.

    Raises:
        InputError: a person and an animal, or a body that the method has not.
    """
    if not isinstance(method, BodyMethod) or len(method.bodies) == 1:
        own = method.body if isinstance(method, BodyMethod) else "human"
        if asked not in ("auto", own):
            raise InputError(f"--body: expected {own} with the model {method.name}, found {asked}; leave it out")
        return method
    if asked != "auto":
        return method.of_body(asked)
    identity, driving = (
        rig or _shown_body(method, mesh, norm) for rig, mesh, norm in zip(rigs.bodies, meshes, norms, strict=True)
    )
    if identity == driving:
        return method.of_body(identity)
    names = meshes[0].name, meshes[1].name
    raise InputError(
        f"{names[0]} is taken for {KINDS[identity]}, and {names[1]} for {KINDS[driving]}: expected two of a kind; "
        "give another driving, or --body human or quadruped if one of the two is taken for the wrong one"
    )


def _shown_body(method: BodyMethod, mesh: Mesh, norm: Normalization) -> str:
    """Tell whose shape a mesh has."""
    upright = normalised(mesh, norm)
    entropy = {body: method.of_body(body).quick_predict(upright)[0] for body in method.bodies}
    return "quadruped" if entropy["quadruped"] + MARGIN < entropy["human"] else "human"
