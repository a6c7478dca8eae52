"""Look at a mesh: which way it stands, and whether it is a person or a four-legged animal.

Axes come from the user, the file, its joints, or the shape, in this order. The body comes from the joints of a file; of
bare surfaces the networks of both bodies predict joints once, and the one with the more decided skinning weights is
taken. A fit of the body says more and takes longer: it is the second look (`second_look`), which alone decides what is
refused. A sheep that is taken for a person fits no person, and a chair fits neither.

Each mesh is looked at alone. Only where the two are taken for different bodies is one looked at again: beside an
animal, a mesh that is not clearly a person is one (`agreed`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..bodies import load_body
from ..bodies.character_limbs import FindJoints, match_joints, without_tails
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError, RefusedMeshError, option
from ..core.geometry import face_normals
from ..core.mesh import Mesh
from ..core.normalization import (
    ORIENTATIONS,
    Normalization,
    axis_name,
    bbox_centre,
    parse_axis,
    turned_to_front,
    without_heading,
)
from ..core.rig import Rig
from ..core.surface_points import at_barycentric, generator, sample_surface
from ..core.threads import both
from ..methods.base import Method
from ..methods.find import INDEX_PAIRED, NETWORK_OF_BODY, SHIPPED_NETWORKS, TABLE_MODELS, find_mime
from ..mime.model import Mime
from ..mime.weights import CoarseSurface
from ..rigs.confidence import MAX_ENTROPY, MAX_OTHER_KIND, MAX_SPREAD, Confidence, if_it_is

UpFront = tuple[str | None, str | None]
"""Up and front of a mesh; None is detected."""
MOST_PARTS = 12
"""Parts of a mesh that a message names."""
LARGE_PART = 0.7
"""Length of a part over that of the mesh along the same axis, from which on the part may be a character."""
OTHER = "other"
"""Choice of `--body` for what is neither a person nor a four-legged animal."""
KINDS = {"human": "a person", "quadruped": "a four-legged animal"}
PLURAL = {"human": "people", "quadruped": "four-legged animals"}
"""What meshes with each body are called in messages."""
MARGIN = 0.1
"""By how much the entropy of the skinning weights (nats) must be lower for an animal than for a person. Chosen on the
splits train and val of the pool (docs/log/animals.md): most files show people."""
ENTROPY_TOLERANCE = 0.45
"""By how much less decided (nats) the network of animals may be on a mesh that is moved as one beside a clear animal.
Chosen on the same meshes: the largest of an animal, a pug, is 0.43. Animals are not moved as people: MARGIN favours
people already."""
MIN_GAIN = 0.15
"""Decrease of the skinning weights' mean entropy (nats) from which on other axes are taken (docs/log/mime.md)."""
OPEN = 0.7
"""By how much less decided (nats) than the most decided orientation another one may be to be fitted. Of sitting people
who are not recognised at first, the right one is at most 0.3 above (docs/log/mime.md, 2026-11-28)."""
SHAPE_WEIGHT = 1.5
"""Weight of the logarithm of the mismatch (mm) beside the entropy (nats), by which orientations are compared. Tuned on
people who sit, and on the pool without axes (docs/log/mime.md, 2026-11-28)."""
FITS = 0.0
"""Largest `Confidence.misfit` of a mesh that surely has the body: above it the other body is fitted, too."""
REJECTION_THRESHOLD = 1.8
"""Largest `Confidence.misfit` of a mesh that is moved at all, with a note from MAX_OTHER_KIND on. Tuned on
development data (docs/log/mime.md, 2026-11-27): ordinary people at the joint limits reach 1.76."""
HALF_TURN = 0.008
"""Mean distance (in root mean square radii) up to which a surface and itself after half a turn count as the same. Of
things that are 0.006 is the largest, of 663 people, animals and creatures 0.013 is the smallest (docs/log/mime.md)."""
TURNED_SPREAD = 7.0
"""Largest spread (degrees) of the predictions for a person of whom that is true: figures of boxes have 3 to 6, ladders
and letters 8 or more."""
DENSE, COARSE = 30_000, 5_000
"""Vertices of a mesh of which a coarse surface is looked at where it is not recognised, and cells of that: two or three
times as many vertices. Each of up to 18 fits and 200 predictions takes time in proportion to them."""
TURNED_POINTS, TURNED_STEPS, TURNED_NEAR = 8192, 16, 0.06
"""Points of the surface that turned ones are compared with, an eighth of them turned, in so many steps; and the
distance (root mean square radii) up to which it counts along the normal, because samples of one surface lie some way
apart."""


@dataclass(frozen=True, eq=False)
class Subject:
    """One of the two meshes, and what is known of it before a network looks at it."""

    mesh: Mesh
    """Of a clip the first frame."""
    axes: UpFront
    """As the user or the joints of the file say."""
    body: str | None = None
    """Shipped body whose joints the file has, if they are used."""

    @cached_property
    def norm(self) -> Normalization:
        """The normalisation in the axes that are given, or that the shape of a person shows."""
        return Normalization.fit(self.mesh, *self.axes)

    @property
    def knows_front(self) -> bool:
        """Whether its front is not only what the shape shows."""
        return self.axes[1] is not None or not self.norm.detected


class Look(NamedTuple):
    """What a mesh is taken for."""

    body: str
    norm: Normalization
    """Its normalisation as that."""
    difference: float
    """By how much the network of the other body is less decided (nats)."""
    entropy: float = 0.0
    """Mean entropy (nats) of the weights of the network of a person; 0 of known bodies."""
    front: Normalization | None = None
    """The normalisation in which it faces the front, where a prediction for a person was made (`facing_front`)."""


def agreed(mime: Mime, asked: str, subjects: tuple[Subject, Subject]) -> tuple[Mime, tuple[Look, Look]]:
    """Decide which body both meshes have; return its network, and the looks at both.

    Args:
        asked: one of the values of `Hints.body`. A file's joints say it for both.

    Raises:
        InputError: a person and an animal, or a body that there is no network for.
    """
    if len(mime.bodies) == 1:
        check_known_body(mime, asked)
        return mime, (known_look(mime, subjects[0]), known_look(mime, subjects[1]))
    known = next((of.body for of in subjects if of.body is not None), None) if asked == "auto" else asked
    second, first = both(*(partial(look, mime, subject, known, quick=True) for subject in subjects[::-1]))
    looks = [first, second]
    if looks[0].body != looks[1].body:
        person = int(looks[1].body == "human")
        looks[person] = look(mime, subjects[person], known)  # it may be an animal in an orientation that was not tried
        if looks[person].body == "human":
            if looks[person].difference <= min(ENTROPY_TOLERANCE, looks[1 - person].difference):
                looks[person] = look(mime, subjects[person], "quadruped")
            else:
                found = [of.body or second_look(mime, seen.body, of) for of, seen in zip(subjects, looks, strict=True)]
                if None in found or found[0] != found[1]:
                    raise RefusedMeshError(different_kinds(found, subjects))
                looks = [look(mime, subject, found[0]) for subject in subjects]
    return mime.of_body(looks[0].body), (looks[0], looks[1])


def known_look(mime: Mime, subject: Subject) -> Look:
    """Return the look at a mesh that has the body of a network."""
    return Look(mime.body, subject.norm, np.inf)


def look(mime: Mime, subject: Subject, known: str | None, quick: bool = False) -> Look:
    """Tell whose shape a mesh has, if that is not known.

    Args:
        known: the body that it has, or None.
        quick: do not look for an animal in all 24 orientations where the mesh looks like a person.
    """
    mesh, norm, axes = subject.mesh, subject.norm, subject.axes
    if subject.body is not None or known == "human":
        return Look(subject.body or "human", norm, np.inf)
    front, person = None, np.inf
    if known is None:
        front, person = facing_front(mime.of_body("human"), mesh, norm, subject.knows_front)
    unsure = norm.detected and norm.up_from != "file" and axes[0] is None
    if quick and unsure and person < MAX_ENTROPY:
        return Look("human", norm, MAX_ENTROPY - person, person, front)
    lowest, _, turned = predicted_orientation(mime.of_body("quadruped"), mesh, norm, axes)
    if known is None and lowest + MARGIN < person:  # a person may be recognised in another orientation, too
        person = predicted_orientation(mime.of_body("human"), mesh, norm, axes)[0]
    difference = person - lowest - MARGIN
    if difference <= 0:
        return Look("human", norm, -difference, person, front)
    # What the detector of people says about the shape of an animal does not count. Where up is known, the network finds
    # the front of the animals of `research/measure_body_choice.py` without an error.
    sure = axes[0] is not None or turned.up_from == "file"
    return Look("quadruped", dataclasses.replace(turned, shape_up=None, margin=float(sure)), difference, person)


def second_look(mime: Mime, taken: str, subject: Subject, confidence: Confidence | None = None) -> str | None:
    """Say which body a mesh has, by fits of the bodies; None: it looks like none, and is refused.

    It has the body that it was taken for if that fits, else the one that fits better and that the predictions agree on.
    An uncertain mesh has the one or the other, too, and the result gets a note. What half a turn leaves as it is has no
    front: a table is no animal, and a lamp no person, however well they fit.

    Args:
        confidence: of the body that it was taken for, if that was fitted already.
    """
    coarse = coarse_mesh(subject.mesh)
    confidence = confidence or predicted_body(mime.of_body(taken), coarse, subject.axes)[2]
    if not confidence.fitted:
        return taken
    turned = same_after_half_turn(subject.mesh)
    if confidence.misfit <= FITS and not turned:
        return taken
    fits = {taken: confidence}
    for body in mime.bodies:
        fit = fits.get(body) or predicted_body(mime.of_body(body), coarse, subject.axes)[2]
        fits |= {body: fit} if fit.fitted else {}
    return fitting_body(taken, fits, turned)


def fitting_body(taken: str, fits: Mapping[str, Confidence], turned: bool) -> str | None:
    """Decide which body a mesh has by the fits of several: see `second_look`.

    Args:
        turned: half a turn leaves the mesh as it is.
    """
    if turned:
        person = fits.get("human")
        found = person is not None and person.misfit < FITS and person.prediction_spread <= TURNED_SPREAD
        return "human" if found else None
    agreed_on = [body for body, fit in fits.items() if body == taken or fit.prediction_spread <= MAX_SPREAD]
    best = min(agreed_on, key=lambda body: fits[body].misfit)
    return next((body for body in (best, *fits) if fits[body].misfit <= REJECTION_THRESHOLD), None)


def same_after_half_turn(mesh: Mesh) -> bool:
    """Return whether half a turn about an axis through the middle of its box leaves a surface as it is."""
    if len(mesh.faces) == 0:
        return False
    from scipy.spatial import KDTree

    chosen, barycentric = sample_surface(mesh.vertices, mesh.faces, TURNED_POINTS, generator(0, 0))
    points = at_barycentric(mesh.vertices, mesh.faces, chosen, barycentric) - bbox_centre(mesh.vertices)
    points /= np.sqrt(np.square(points).sum(axis=1).mean())
    normals, tree = face_normals(mesh.vertices, mesh.faces)[chosen], KDTree(points)
    for axis in range(3):
        turned = np.where(np.arange(3) == axis, 1, -1) * points[: TURNED_POINTS // 8]
        total = 0.0
        # A few at a time: most shapes are so far from themselves that some decide.
        for some in np.split(turned, TURNED_STEPS):
            distance, nearest = tree.query(some)
            along = np.abs(((some - points[nearest]) * normals[nearest]).sum(axis=1))
            total += np.where(distance < TURNED_NEAR, along, distance).sum()
            if total >= HALF_TURN * len(turned):
                break
        else:
            return True
    return False


def other_body(
    mime: Mime, taken: str, subjects: tuple[Subject, Subject], confidences: tuple[Confidence | None, Confidence | None]
) -> str | None:
    """Return the body that both meshes have after all, where it is not the one that they were taken for.

    Args:
        confidences: of these fits; None of a mesh whose file has the joints.

    Raises:
        RefusedMeshError: a mesh has neither body, or one has the one body and the other another one.
    """
    found = [
        second_look(mime, taken, subject, confidence) if confidence else taken
        for subject, confidence in zip(subjects, confidences, strict=True)
    ]
    if None in found or found[0] != found[1]:
        raise RefusedMeshError(different_kinds(found, subjects))
    return None if found[0] == taken else found[0]


def different_kinds(found: list[str | None], subjects: tuple[Subject, Subject]) -> str:
    """Say which kinds two meshes are of, and what helps."""
    names = [subject.mesh.name for subject in subjects]
    if None in found:
        odd, other = (0, 1) if found[0] is None else (1, 0)
        alone = subjects[0] is subjects[1]
        body = found[other]
        beside = f", as {names[other]} is {KINDS[body]}" if body else ""
        mesh = subjects[odd].mesh
        parts = list(dict.fromkeys(part.name for part in mesh.parts))
        asked = option("driving_part" if odd and not alone else "part", ...)
        several = ", perhaps several characters" * has_large_parts(mesh)
        scene = f"{several}; of its parts ({', '.join(parts[:MOST_PARTS])}) {asked} takes one" * (len(parts) > 1)
        return (
            f"{names[odd]}: expected a person or a four-legged animal{beside}, found a shape that looks like "
            f"neither, as far as can be told{scene}; {if_it_is(alone)}"
        )
    first, second = (KINDS[body] for body in found if body is not None)
    parts = [
        f", or {option(asked, ...)} if {of.mesh.name} is more than one thing"
        for asked, of in zip(("part", "driving_part"), subjects, strict=True)
        if len(of.mesh.parts) > 1
    ]
    return (
        f"{names[0]} is taken for {first}, and {names[1]} for {second}: expected two of a kind; give "
        f"another driving, or {option('body', 'human')} or quadruped if one of the two is taken for the wrong one"
        + "".join(parts)
    )


def has_large_parts(mesh: Mesh) -> bool:
    """Return whether two of a mesh's first parts are beside each other, each almost as long as the mesh along an axis.

    Clothes are not beside the body, and limbs are shorter than it.
    """
    boxes = []
    for part in mesh.parts[:MOST_PARTS]:
        points = mesh.vertices[mesh.faces[part.start : part.stop]].reshape(-1, 3)
        if len(points) and (np.ptp(points, axis=0) > LARGE_PART * np.ptp(mesh.vertices, axis=0)).any():
            boxes.append((points.min(axis=0), points.max(axis=0)))
    return any((low > high).any() for low, _ in boxes for _, high in boxes)


def normalised(mesh: Mesh, norm: Normalization) -> Mesh:
    """Apply a normalisation to the vertices of a mesh."""
    return dataclasses.replace(mesh, vertices=norm.apply(mesh.vertices), up="+y")


def facing_front(mime: Mime, mesh: Mesh, norm: Normalization, known: bool) -> tuple[Normalization, float]:
    """Take the heading of a mesh out of its normalisation: predictions depend on it.

    Args:
        known: its front is not only what the shape shows.

    Returns also the mean entropy (nats) of the weights of the prediction that shows the front.
    """
    person = mime.body == "human"  # the front of an animal was found by its network (see `look`)
    rough = without_heading(mesh, norm, known, person)
    entropy, hips = mime.quick_predict(normalised(mesh, rough))
    return turned_to_front(mesh, rough, hips[:, 2], known or not person), entropy


def reorient(
    mime: Mime, mesh: Mesh, norm: Normalization, axes: UpFront, confidence: Confidence | None
) -> Normalization:
    """Return a normalisation with corrected axes, or the same one if no other orientation is clearly better.

    Needed only where axes were detected and the mesh is not recognised in them. The most decided prediction wins. Where
    up is not known, a body is fitted in each orientation in which a prediction stands, and the nearest shape wins:
    people who sit with folded legs may be as decided upside down. What would be refused as it is must look like the
    body in another one, as things often fit a little better somewhere.
    """
    if not norm.detected or confidence is None or confidence.recognised:
        return norm
    predictions = oriented_predictions(mime, mesh, norm, axes)
    lowest, detected, chosen = most_decided(predictions, norm)
    # A small gain may be noise of the prediction: the detector's axes are then kept.
    decided = norm if lowest > detected - MIN_GAIN else chosen
    others = [other for other in standing_orientations(predictions) if other.up != decided.up]
    if not (confidence.fitted and others):
        return decided
    coarse = coarse_mesh(mesh)
    facing = [facing_front(mime, coarse, other, known=True)[0] for other in (decided, *others)]
    fits = [
        (other, mime.fit(normalised(coarse, front)).confidence)
        for other, front in zip((decided, *others), facing, strict=True)
    ]
    # The entropy of the weights (nats) is larger where the shapes of body and surface differ.
    costs = [fit.weight_entropy + SHAPE_WEIGHT * fit.features()["fit_distance"] for _, fit in fits]
    best, nearest = fits[int(np.argmin(costs))]
    refused = fits[0][1].misfit > REJECTION_THRESHOLD
    return decided if refused and nearest.misfit > MAX_OTHER_KIND else _present_or(norm, best)


def coarse_mesh(mesh: Mesh) -> Mesh:
    """Return a coarse surface of a dense mesh, and others as they are: what it is and how it stands is no detail."""
    if len(mesh.vertices) <= DENSE or len(mesh.faces) == 0:
        return mesh
    surface = CoarseSurface.of(mesh.vertices, mesh.faces, COARSE)
    return Mesh(surface.points, surface.faces, mesh.name, up=mesh.up)


def standing_orientations(predictions: list[OrientedPrediction]) -> list[Normalization]:
    """List the orientations, one for each up axis, in which the hips of the most decided prediction are upright.

    Those whose entropy is more than OPEN above the lowest are left out.
    """
    best: dict[str, OrientedPrediction] = {}
    for prediction in predictions:
        up = prediction.norm.up
        best[up] = min(best.get(up, prediction), prediction, key=lambda other: other.entropy)
    lowest = min(prediction.entropy for prediction in best.values())
    return [
        prediction.norm
        for prediction in best.values()
        if prediction.entropy <= lowest + OPEN and axis_name(prediction.hips[:, 1]) == "+y"
    ]


class OrientedPrediction(NamedTuple):
    """A prediction of a mesh in one of the 24 orientations along its axes."""

    entropy: float
    """Mean entropy (nats) of the skinning weights."""
    norm: Normalization
    hips: Float[np.ndarray, "3 3"]
    """Rotation of the hips in it."""


def oriented_predictions(mime: Mime, mesh: Mesh, norm: Normalization, axes: UpFront) -> list[OrientedPrediction]:
    """Predict once in each of the 24 orientations that the axes of the user and the file allow.

    These are 4 where up is known, 1 where front is, too.
    """
    up, front = parse_axis(axes[0], option("up")), parse_axis(axes[1], option("front"))
    up = norm.up if norm.up_from == "file" else up
    allowed = [names for names in ORIENTATIONS if up in (None, names[0]) and front in (None, names[1])]
    predictions, coarse = [], coarse_mesh(mesh)
    for names in allowed:
        candidate = Normalization.fit(mesh, *names)
        entropy, hips = mime.quick_predict(normalised(coarse, candidate))
        predictions.append(OrientedPrediction(entropy, candidate, hips))
    return predictions


def predicted_orientation(
    mime: Mime, mesh: Mesh, norm: Normalization, axes: UpFront
) -> tuple[float, float, Normalization]:
    """Find the orientation in which a network's prediction is most decided: see `most_decided`."""
    return most_decided(oriented_predictions(mime, mesh, norm, axes), norm)


def most_decided(predictions: list[OrientedPrediction], norm: Normalization) -> tuple[float, float, Normalization]:
    """Choose the orientation whose prediction is most decided.

    The one with the lowest entropy of skinning weights wins, and the axes of the hips predicted in it, rounded to the
    mesh's, are the new up and front.

    Returns the lowest entropy (nats), that in the present orientation, and the normalisation with the new axes: the
    present one if they are the same.
    """
    lowest, best, hips = min(predictions, key=lambda prediction: prediction.entropy)
    # Columns 1 and 2 of the hips' rotation are their up and front; `best.rotation.T` brings them into the mesh's axes.
    names = tuple(axis_name(best.rotation.T @ hips[:, k]) for k in (1, 2))
    chosen = next((n for _, n, _ in predictions if (n.up, n.front) == names), best)
    present = next(entropy for entropy, n, _ in predictions if (n.up, n.front) == (norm.up, norm.front))
    return lowest, present, _present_or(norm, chosen)


def _present_or(norm: Normalization, chosen: Normalization) -> Normalization:
    """Return the present normalisation if another one has the same axes, else that one, as an uncertain one."""
    if (chosen.up, chosen.front) == (norm.up, norm.front):
        return norm
    # A margin of 0 makes the report say that the facing is uncertain.
    return dataclasses.replace(chosen, detected=True, margin=0.0, up_from=norm.up_from, shape_up=norm.shape_up)


def predicted_body(mime: Mime, mesh: Mesh, axes: UpFront) -> tuple[Normalization, Rig, Confidence]:
    """Predict the joints of a mesh, in another orientation where the first is wrong; returns its normalisation, too."""
    norm = Normalization.fit(mesh, *axes)
    body, confidence = mime.predict_rig(normalised(mesh, norm))
    other = reorient(mime, mesh, norm, axes, confidence)
    if other is not norm:
        norm = other
        body, confidence = mime.predict_rig(normalised(mesh, norm))
    return norm, body, confidence


def looks_like(mime: Mime, mesh: Mesh, axes: UpFront) -> Iterator[str]:
    """Yield the bodies that a mesh is recognised as."""
    coarse = coarse_mesh(mesh)
    return (body for body in mime.bodies if predicted_body(mime.of_body(body), coarse, axes)[2].whole)


def finds_joints(mime: Mime) -> bool:
    """Return whether a network predicts the joints of the shipped body, which those of other rigs are compared with."""
    return mime.joints == load_body().joint_names


def joint_finder(mime: Mime, axes: UpFront) -> FindJoints:
    """Make the function that finds the joints of a rig whose names say nothing, by the surface that they move."""

    def find(rig: SkinnedCharacter) -> dict[str, int]:
        for shown in (rig, *without_tails(rig)):
            norm, body, confidence = predicted_body(mime, dataclasses.replace(shown.mesh, up="+y"), axes)
            if confidence.recognised:
                return match_joints(shown, dataclasses.replace(body, joints=norm.undo(body.joints)), rig.mesh.name)
        raise InputError(
            f"{rig.mesh.name}: expected thighs and upper arms that move vertices and have the names of a person's, or "
            "the shape of a person, found neither; rename the joints, for example LeftUpLeg, LeftArm"
        )

    return find


def recognised_body(subject: Subject) -> str | None:
    """Say which body a mesh has by its shape alone; None: it looks like none.

    Nothing is fitted to what looks like a person: for a note that would cost more than the transfer.
    """
    mime = find_mime(NETWORK_OF_BODY["human"])
    shown = look(mime, subject, None, quick=True)
    if shown.body == "human" and shown.entropy <= MAX_ENTROPY and not same_after_half_turn(subject.mesh):
        return shown.body
    return second_look(mime, shown.body, subject)


def check_known_body(model: Mime | Method, asked: str) -> None:
    """Raise InputError if a model of one body is asked for another one."""
    own = getattr(model, "body", "human")
    if asked not in ("auto", own):
        raise InputError(
            f"{option('body')}: expected {own} with the model {model.name}, found {asked}: it knows only "
            f"{PLURAL[own]}; choose the model mime"
        )


def trained_on_people(method: Method, asked: str, subjects: tuple[Subject, Subject]) -> tuple[str, ...]:
    """Return notes on meshes that are no people, for networks of the papers that were trained on people.

    Networks of users are left out: what they were trained on is not known.

    Args:
        asked: what the user says that both meshes are; "auto" looks at them.
    """
    if asked != "auto" or getattr(method, "body", None) != "human":
        return ()
    if method.name not in (*SHIPPED_NETWORKS, *INDEX_PAIRED.values(), *TABLE_MODELS):
        return ()
    notes = []
    for subject in subjects:
        body = recognised_body(subject)
        if body != "human":
            looks = f"looks like {KINDS[body]}" if body else "looks neither like a person nor like a four-legged animal"
            mime = option("model", "mime")
            helps = f"{mime} moves it" if body else f"people and four-legged animals are moved by {mime}"
            notes.append(
                f"{subject.mesh.name} {looks}, as far as can be told, and the weights of {method.name} were trained on "
                f"people: the result is probably useless; {helps}, and {option('body', 'human')} says that it is a "
                "person"
            )
    return tuple(notes)


def turned_as_animal(subject: Subject) -> Normalization:
    """Return the normalisation of an animal whose axes are not known, for networks of the papers.

    The detector was trained on people; the network that finds animals' joints tells which way an animal faces.
    """
    if not subject.norm.detected:
        return subject.norm
    finder = find_mime(NETWORK_OF_BODY["quadruped"])
    return predicted_orientation(finder, subject.mesh, subject.norm, subject.axes)[2]
