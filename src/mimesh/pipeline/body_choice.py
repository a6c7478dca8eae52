"""Choose the shipped body whose joints both meshes have: that of a person, that of a four-legged animal, or none.

A rig in one of the files says it for both. Of two meshes without rigs both networks predict the joints once, and the
one with the more decided skinning weights is taken; beside an animal, a mesh that is not clearly a person is one. Two
rigs that are neither of people nor of animals are matched with each other (`creatures.py`), unless both surfaces look
like one of the two.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..core.errors import InputError, RefusedMeshError
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..methods.base import BodyMethod, Method, RigMethod
from ..methods.confidence import MAX_ENTROPY
from ..methods.find import INDEX_PAIRED, NETWORK_OF_BODY, SHIPPED_NETWORKS, TABLE_MODELS, find_method
from .creatures import SURE, SURE_ACROSS, MatchedCreatures, match_creatures, sure_match
from .matched_rigs import finds_joints, predicted_body
from .orientation import normalised, predicted_orientation
from .rigs import OTHER, Axes, Rigs
from .second_look import KINDS, PLURAL, UpFront, different_kinds, second_look

BODIES = ("auto", *NETWORK_OF_BODY, OTHER)
"""Choices of `--body`."""
MARGIN = 0.1
"""By how much the entropy of the skinning weights (nats) must be lower for an animal than for a person. Chosen on the
splits train and val of the pool (docs/log/animals.md): most files show people."""
ENTROPY_TOLERANCE = 0.45
"""By how much less decided (nats) the network of animals may be on a mesh that is moved as one beside a clear animal.
Chosen on the same meshes: the largest of an animal, a pug, is 0.43. Animals are not moved as people: MARGIN favours
people already."""


def check_body(body: str) -> None:
    """Raise InputError if a choice is none of BODIES."""
    if body not in BODIES:
        raise InputError(f"--body: expected one of {', '.join(BODIES)}, found {body!r}; choose one of them")


def matched_creatures(
    method: Callable[[], Method],
    asked: str,
    rigs: Rigs,
    read: Callable[[RigMethod], Rigs],
    identity: Mesh,
    clip: Clip,
    axes: Axes,
) -> MatchedCreatures | None:
    """Match the rigs of both files with each other, if these are of other creatures; None: the method moves the mesh.

    Args:
        method: makes the method.
        asked: one of BODIES.
        rigs: as they are read by the names of their joints.
        read: reads them again, with joints found by the surfaces that they move.

    Raises:
        InputError: the rigs are of other creatures, and are not matched with certainty.
    """
    if asked not in ("auto", OTHER) or (asked == "auto" and not any(rigs.unnamed)):
        return None
    try:
        matched = match_creatures(identity, clip, axes)
    except InputError:
        if asked == OTHER:
            raise
        return None  # the note of `rigs` says what is wrong with it
    if matched is None or asked == OTHER:
        return matched if matched is None else sure_match(matched, SURE)
    finder = method()
    if not finds_joints(finder) or None not in read(finder).bodies:
        return None
    mixed = any(body is not None for body in rigs.bodies)
    least, advice = SURE_ACROSS if mixed else SURE, ""
    if matched.match.confidence < least:
        shown = [
            {own} if own is not None else looks_like(finder, mesh, of_mesh)
            for own, mesh, of_mesh in zip(rigs.bodies, (identity, clip.mesh), (axes[:2], axes[2:]), strict=True)
        ]
        if shown[0] & shown[1]:  # the joints are found on the surface, and a note says why
            return None
        advice = _surface_advice(shown, (identity.name, clip.mesh.name))
    return sure_match(matched, least, advice)


def _surface_advice(shown: list[set[str]], names: tuple[str, str]) -> str:
    """Say how to move two meshes of which only one is known to be a person or an animal, if the other is one, too."""
    for k in (0, 1):
        if shown[k] and not shown[1 - k]:
            body = min(shown[k])
            return f"; if {names[1 - k]} is {KINDS[body]}, too, --rig mimesh --body {body} finds joints on the surfaces"
    return ""


def looks_like(method: RigMethod, mesh: Mesh, axes: UpFront) -> set[str]:
    """List the bodies that a mesh is recognised as."""
    if not isinstance(method, BodyMethod):
        return set()
    networks = {body: method.of_body(body) for body in method.bodies}
    return {
        body
        for body, network in networks.items()
        if isinstance(network, RigMethod) and predicted_body(network, mesh, axes)[2].whole
    }


def with_body(
    method: Method,
    asked: str,
    rigs: Rigs,
    meshes: tuple[Mesh, Mesh],
    norms: tuple[Normalization, Normalization],
    axes: Axes,
) -> tuple[Method, tuple[Normalization, Normalization]]:
    """Return the method for the body of both meshes, and their normalisations: animals are not detected as people are.

    Args:
        method: most methods have one body, and are returned as they are.
        asked: one of BODIES.
        meshes: the identity and the driving.
        axes: up and front of both, where they are known.

    Raises:
        InputError: a person and an animal, or a body that the method has not.
    """
    if not isinstance(method, BodyMethod) or len(method.bodies) == 1:
        own = getattr(method, "body", "human")
        if asked not in ("auto", own):
            raise InputError(
                f"--body: expected {own} with the model {method.name}, found {asked}: it knows only {PLURAL[own]}; "
                "choose the model mime"
            )
        if own == "quadruped" and not isinstance(method, BodyMethod):
            norms = _turned_as_animal(meshes[0], norms[0], axes[:2]), _turned_as_animal(meshes[1], norms[1], axes[2:])
        return method, norms
    known = next((body for body in rigs.bodies if body is not None), None) if asked == "auto" else asked
    given = (axes[:2], axes[2:])

    def show(k: int, known: str | None, quick: bool = False) -> Shown:
        own = rigs.bodies[k]
        return Shown(own, norms[k], np.inf) if own else shown_body(method, known, meshes[k], norms[k], given[k], quick)

    shown = [show(k, known, quick=True) for k in (0, 1)]
    if shown[0].body != shown[1].body:
        person = int(shown[1].body == "human")
        shown[person] = show(person, known)  # it may be an animal in an orientation that was not tried
        if shown[person].body == "human" and shown[person].difference > min(
            ENTROPY_TOLERANCE, shown[1 - person].difference
        ):
            found = [rigs.bodies[k] or second_look(method, shown[k].body, meshes[k], given[k]) for k in (0, 1)]
            if None in found or found[0] != found[1]:
                raise RefusedMeshError(different_kinds(found, meshes))
            shown = [show(k, found[0]) for k in (0, 1)]
        elif shown[person].body == "human":
            shown[person] = show(person, "quadruped")
    return method.of_body(shown[0].body), (shown[0].norm, shown[1].norm)


class Shown(NamedTuple):
    """What a mesh is taken for."""

    body: str
    norm: Normalization
    """Its normalisation as that."""
    difference: float
    """By how much the network of the other body is less decided (nats)."""
    entropy: float = 0.0
    """Mean entropy (nats) of the weights of the network of a person; 0 of known bodies."""


def shown_body(
    method: BodyMethod,
    known: str | None,
    mesh: Mesh,
    norm: Normalization,
    axes: UpFront,
    quick: bool,
) -> Shown:
    """Tell whose shape a mesh has, if that is not known.

    Args:
        quick: do not look for an animal in all 24 orientations where the mesh looks like a person.
    """
    if known == "human":
        return Shown(known, norm, np.inf)
    person = method.of_body("human").quick_predict(normalised(mesh, norm))[0] if known is None else np.inf
    unsure = norm.detected and norm.up_from != "file" and axes[0] is None
    if quick and unsure and person < MAX_ENTROPY:
        return Shown("human", norm, MAX_ENTROPY - person, person)
    lowest, _, turned = predicted_orientation(method.of_body("quadruped"), mesh, norm, axes)
    if known is None and lowest + MARGIN < person:  # a person may be recognised in another orientation, too
        person = predicted_orientation(method.of_body("human"), mesh, norm, axes)[0]
    difference = person - lowest - MARGIN
    if difference > 0:
        return Shown("quadruped", _as_animal(turned, axes[0]), difference, person)
    return Shown("human", norm, -difference, person)


def trained_on_people(
    method: Method, asked: str, meshes: tuple[Mesh, Mesh], norms: tuple[Normalization, Normalization], axes: Axes
) -> tuple[str, ...]:
    """Return notes on meshes that are no people, for networks without joints that were trained on people.

    Networks of users are left out: what they were trained on is not known.

    Args:
        asked: what the user says that both meshes are; "auto" looks at them.
    """
    if asked != "auto" or isinstance(method, RigMethod) or getattr(method, "body", None) != "human":
        return ()
    if method.name not in (*SHIPPED_NETWORKS, *INDEX_PAIRED.values(), *TABLE_MODELS):
        return ()
    notes = []
    for mesh, norm, of_mesh in zip(meshes, norms, (axes[:2], axes[2:]), strict=True):
        body = recognised_body(mesh, norm, of_mesh)[0]
        if body != "human":
            looks = f"looks like {KINDS[body]}" if body else "looks neither like a person nor like a four-legged animal"
            helps = "-m mime moves it" if body else "people and four-legged animals are moved by -m mime"
            notes.append(
                f"{mesh.name} {looks}, as far as can be told, and the weights of {method.name} were trained on people: "
                f"the result is probably useless; {helps}, and --body human says that it is a person"
            )
    return tuple(notes)


def recognised_body(mesh: Mesh, norm: Normalization, axes: UpFront) -> tuple[str | None, Normalization]:
    """Say which body a mesh has by its shape alone, and its normalisation as that; None: it looks like none."""
    method = find_method(NETWORK_OF_BODY["human"])
    assert isinstance(method, BodyMethod)
    shown = shown_body(method, None, mesh, norm, axes, quick=True)
    if shown.body == "human" and shown.entropy <= MAX_ENTROPY:
        return shown.body, shown.norm
    body = second_look(method, shown.body, mesh, axes)
    if body not in (None, shown.body):
        shown = shown_body(method, body, mesh, norm, axes, quick=False)
    return body, shown.norm


def _as_animal(norm: Normalization, up: str | None) -> Normalization:
    """Return the normalisation of an animal: what the detector of people says about its shape does not count.

    Where up is known, the network finds the front of the animals of `research/measure_body_choice.py` without an error.
    """
    known = up is not None or norm.up_from == "file"
    return dataclasses.replace(norm, shape_up=None, margin=1.0 if known else 0.0)


def _turned_as_animal(mesh: Mesh, norm: Normalization, axes: UpFront) -> Normalization:
    """Return the normalisation of an animal whose axes are not known, for methods that predict no joints.

    The detector was trained on people; the network that finds animals' joints tells which way an animal faces.
    """
    if not norm.detected:
        return norm
    finder = find_method(NETWORK_OF_BODY["quadruped"])
    assert isinstance(finder, BodyMethod)
    return predicted_orientation(finder, mesh, norm, axes)[2]
