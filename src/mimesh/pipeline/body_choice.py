"""Choose the shipped body whose joints both meshes have: that of a person, or that of a four-legged animal.

A rig in a file says it. Of other meshes both networks predict the joints once, and the one with the more decided
skinning weights is taken.
"""

from __future__ import annotations

import dataclasses

from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.normalization import Normalization
from ..methods.base import Method
from ..methods.find import NETWORK_OF_BODY, find_method
from ..methods.mime.drive import MimeMethod
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
    """Return the method for the body of both meshes; only the shipped `mime` has several.

    Args:
        asked: one of BODIES.
        meshes: the identity and the driving.

    Raises:
        InputError: a person and an animal, or a body that the method has not.
    """
    if not isinstance(method, MimeMethod) or method.name != NETWORK_OF_BODY["human"]:
        own = method.body if isinstance(method, MimeMethod) else "human"
        if asked not in ("auto", own):
            raise InputError(f"--body: expected {own} with the model {method.name}, found {asked}; leave it out")
        return method
    if asked != "auto":
        return _network(method, asked)
    # Opening the other network takes a while, so it is left alone where both rigs say what they are.
    networks = {body: _network(method, body) for body in NETWORK_OF_BODY} if None in rigs.bodies else {}
    identity, driving = (
        rig or _shown_body(networks, mesh, norm) for rig, mesh, norm in zip(rigs.bodies, meshes, norms, strict=True)
    )
    if identity == driving:
        return networks.get(identity) or _network(method, identity)
    names = meshes[0].name, meshes[1].name
    raise InputError(
        f"{names[0]} is taken for {KINDS[identity]}, and {names[1]} for {KINDS[driving]}: expected two of a kind; "
        "give another driving, or --body human or quadruped if one of the two is taken for the wrong one"
    )


def _network(method: MimeMethod, body: str) -> MimeMethod:
    """Open the network of a body with the options of another."""
    if method.body == body:
        return method
    other = find_method(NETWORK_OF_BODY[body], seed=method.seed)
    assert isinstance(other, MimeMethod)
    return dataclasses.replace(other, name=method.name)


def _shown_body(networks: dict[str, MimeMethod], mesh: Mesh, norm: Normalization) -> str:
    """Tell whose shape a mesh has."""
    upright = normalised(mesh, norm)
    entropy = {body: network.quick_predict(upright)[0] for body, network in networks.items()}
    return "quadruped" if entropy["quadruped"] + MARGIN < entropy["human"] else "human"
