"""Proportions and standing postures of the animals that the quadruped body is made from, as factors on a dog's bones.

Looked up in no book: chosen by eye, beside pictures drawn by `build_quadruped.py --draw`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

Factors = Mapping[str, float]


class Bump(NamedTuple):
    """A bell-shaped displacement of the dog's skin at rest, in metres; mirrored where it lies beside the middle."""

    joint: str
    offset: tuple[float, float, float]
    """Of its centre from the joint."""
    radius: float
    push: tuple[float, float, float]


@dataclass(frozen=True)
class Species:
    """An animal as a dog with other bones. Keys are joints without their side."""

    length: Factors = field(default_factory=dict)
    """Factor along each bone."""
    width: Factors = field(default_factory=dict)
    """Factor across each bone, from side to side."""
    height: Factors = field(default_factory=dict)
    """Factor across each bone in the plane of the animal; where none is given, that of `width`."""
    bumps: tuple[Bump, ...] = ()
    height_of_shoulder: float = 0.6
    """Metres from the ground to the top of the shoulder blades."""


def every(names: str, value: float) -> dict[str, float]:
    """Give several joints one value."""
    return dict.fromkeys(names.split(), value)


SPINE = "Spine1 Spine2 Spine3 Spine4 Chest"
NECK = "Neck1 Neck2 Neck3"
TAIL = "Tail1 Tail2 Tail3 Tail4 Tail5 Tail6"
FOREFEET, HINDFEET = "Hand Fingers", "Foot Toes"
STANDING = {"Thigh": -16.0, "Shin": -2.0, "Foot": 18.0, "Jaw": -16.0}
"""Turns of the template, which stands stretched with its mouth open: hind legs under the hips, mouth closed."""
HOOVES = {"Fingers": 0.75, "Toes": 0.75}

SPECIES: dict[str, Species] = {
    "dog": Species(),
    "hound": Species(
        length={**every("Forearm Hand Shin Foot", 1.12), "Head": 1.1, "Ear": 1.2},
        width={**every("Hand Foot", 0.85), "Spine2": 0.85, "Spine1": 0.85},
        height_of_shoulder=0.7,
    ),
    "terrier": Species(
        length={**every("UpperArm Forearm Hand Thigh Shin Foot", 0.6), **every(TAIL, 0.5), "Ear": 0.7},
        width={**every(SPINE, 1.15), **every(NECK, 1.15), "Head": 1.1},
        height={**every(SPINE, 1.05)},
        height_of_shoulder=0.3,
    ),
    "cat": Species(
        length={"Head": 0.6, "Jaw": 0.62, **every(NECK, 0.75), **every("UpperArm Forearm Hand", 0.82), "Ear": 0.7,
                **every("Tail3 Tail4 Tail5 Tail6", 1.15)},
        width={"Head": 1.0, "Jaw": 0.9, "Ear": 1.2, **every("Tail3 Tail4 Tail5 Tail6", 1.6)},
        height={"Head": 0.9, "Chest": 0.9, "Spine4": 0.88},
        height_of_shoulder=0.26,
    ),
    "lion": Species(
        length={"Head": 0.85, "Jaw": 0.85, **every(NECK, 0.9), **every("UpperArm Forearm Hand", 0.85), "Ear": 0.45,
                **every(SPINE, 1.1)},
        width={"Head": 1.35, "Jaw": 1.2, "Ear": 0.8, **every(NECK, 1.5), **every("Forearm Hand Fingers", 1.35),
               **every("Shin Foot Toes", 1.25), **every(SPINE, 1.3), "Tail6": 3.0},
        height={"Head": 1.2, **every(NECK, 1.5), **every(SPINE, 1.1)},
        height_of_shoulder=1.0,
    ),
    "fox": Species(
        length={"Head": 0.95, **every("UpperArm Forearm Hand Thigh Shin Foot", 0.85), "Ear": 1.05, **every(TAIL, 1.05)},
        width={**every("Tail2 Tail6", 2.2), **every("Tail3 Tail4 Tail5", 3.6), "Head": 0.95, **every(NECK, 1.1)},
        height_of_shoulder=0.38,
    ),
    "horse": Species(
        length={**every(NECK, 1.55), "Head": 1.6, "Jaw": 1.5, "Forearm": 1.25, "Hand": 1.7, "Foot": 1.25, "Ear": 0.55,
                **every(TAIL, 0.75), **every(SPINE, 1.08)},
        width={"Head": 1.2, "Jaw": 1.1, **every(SPINE, 1.6), "Hips": 1.35, "Neck1": 1.3, "Neck2": 1.2, "Neck3": 1.15,
               "Thigh": 1.3, "Shin": 1.1, "UpperArm": 1.15, "Hand": 0.9, "Foot": 0.9, "Ear": 0.6,
               **every("Tail2 Tail3 Tail4 Tail5 Tail6", 3.2), **HOOVES},
        height={"Head": 1.3, "Jaw": 1.3, **every(SPINE, 1.15), "Spine1": 1.3, "Spine2": 1.3, "Neck1": 1.7, "Neck2": 1.5,
                "Neck3": 1.3},
        height_of_shoulder=1.6,
    ),
    "donkey": Species(
        length={**every(NECK, 1.3), "Head": 1.55, "Jaw": 1.45, "Forearm": 1.15, "Hand": 1.45, "Foot": 1.15, "Ear": 1.3,
                **every(TAIL, 0.75), **every(SPINE, 1.05)},
        width={"Head": 1.25, "Jaw": 1.15, **every(SPINE, 1.6), "Hips": 1.3, **every(NECK, 1.25), "Thigh": 1.2,
               **HOOVES},
        height={"Head": 1.3, "Jaw": 1.3, **every(SPINE, 1.15), "Spine1": 1.3, "Spine2": 1.3, **every(NECK, 1.5)},
        height_of_shoulder=1.2,
    ),
    "cow": Species(
        length={**every(NECK, 1.15), "Head": 1.4, "Jaw": 1.35, **every("UpperArm Forearm", 0.85), "Hand": 1.15,
                "Ear": 0.75, **every(SPINE, 1.22), **every(TAIL, 0.9)},
        width={"Head": 1.5, "Jaw": 1.4, **every(SPINE, 2.0), "Spine1": 2.2, "Spine2": 2.4, "Hips": 1.6,
               **every(NECK, 1.4), "Thigh": 1.2, **every(FOREFEET, 1.2), **every(HINDFEET, 1.15), "Tail6": 3.0},
        height={"Head": 1.4, "Jaw": 1.3, **every(SPINE, 1.35), "Spine1": 1.6, "Spine2": 1.6, "Hips": 1.25,
                "Neck1": 1.9, "Neck2": 1.7, "Neck3": 1.5},
        bumps=(Bump("Head", (0.045, 0.075, -0.05), 0.016, (0.06, 0.06, 0.02)),),
        height_of_shoulder=1.4,
    ),
    "pig": Species(
        length={**every(NECK, 0.55), "Head": 1.25, "Jaw": 1.1, "UpperArm": 0.65, "Forearm": 0.55, "Hand": 0.65,
                "Foot": 0.6, "Ear": 0.75, **every(TAIL, 0.4), **every(SPINE, 1.15)},
        width={"Head": 1.5, "Jaw": 1.5, **every(SPINE, 2.1), "Hips": 1.6, **every(NECK, 1.9), "Ear": 1.2,
               **every("Thigh UpperArm", 1.2), **HOOVES},
        height={"Head": 1.3, "Jaw": 1.2, **every(SPINE, 1.25), "Spine1": 1.6, "Spine2": 1.6, **every(NECK, 1.9)},
        height_of_shoulder=0.75,
    ),
    "sheep": Species(
        length={**every(NECK, 0.9), "Head": 1.1, "Jaw": 1.0, **every("UpperArm Forearm", 0.75), "Hand": 0.9,
                **every("Shin Foot", 0.8), "Ear": 0.7, **every(TAIL, 0.35), **every(SPINE, 1.05)},
        width={"Head": 1.2, "Jaw": 1.1, **every(SPINE, 2.3), "Hips": 1.8, **every(NECK, 1.8), "Thigh": 1.5,
               "UpperArm": 1.3, **every("Tail1 Tail2 Tail3", 2.0), **HOOVES},
        height={**every(SPINE, 1.35), "Spine1": 1.8, "Spine2": 1.8, "Hips": 1.35, **every(NECK, 1.9), "Head": 1.15},
        height_of_shoulder=0.75,
    ),
    "goat": Species(
        length={**every(NECK, 1.15), "Head": 1.15, "Jaw": 1.1, "Hand": 1.1, "Ear": 0.8, **every(TAIL, 0.35)},
        width={**every(SPINE, 1.6), "Spine2": 1.9, "Hips": 1.3, **every(NECK, 1.1), "Hand": 0.9, **HOOVES},
        height={**every(SPINE, 1.15), "Spine1": 1.5, "Spine2": 1.5},
        bumps=(Bump("Head", (0.02, 0.08, -0.03), 0.014, (0.02, 0.12, -0.08)),),
        height_of_shoulder=0.75,
    ),
    "deer": Species(
        length={**every(NECK, 1.3), "Head": 1.15, "Jaw": 1.1, "Forearm": 1.2, "Hand": 1.5, "Foot": 1.2,
                **every(TAIL, 0.35), "Ear": 1.1},
        width={"Head": 0.95, **every("Hand Foot", 0.75), **every("Spine2 Spine3", 1.3), "Forearm": 0.85, "Ear": 1.1,
               **every("Tail2 Tail3", 1.6), "Fingers": 0.65, "Toes": 0.65},
        bumps=(Bump("Head", (0.022, 0.08, -0.03), 0.013, (0.07, 0.2, -0.03)),),
        height_of_shoulder=1.1,
    ),
    "camel": Species(
        length={**every(NECK, 2.3), "Head": 1.25, "Jaw": 1.2, "Forearm": 1.5, "Hand": 1.5, "Foot": 1.1, "Ear": 0.45,
                **every(TAIL, 0.6)},
        width={"Head": 1.15, **every(SPINE, 1.5), "Neck1": 1.1, "Ear": 0.6, **every(FOREFEET, 1.15), "Fingers": 1.4,
               "Toes": 1.4},
        height={**every(SPINE, 1.15), "Neck1": 1.4, "Neck2": 1.1},
        bumps=(Bump("Spine3", (0.0, 0.04, 0.0), 0.11, (0.0, 0.15, 0.0)),),
        height_of_shoulder=1.9,
    ),
    "giraffe": Species(
        length={**every(NECK, 4.2), "Head": 1.3, "Jaw": 1.2, "Forearm": 1.9, "Hand": 2.0, "Foot": 1.4, "Ear": 0.7,
                **every(SPINE, 0.85), **every(TAIL, 0.7)},
        width={**every(SPINE, 1.4), "Neck1": 1.2, **HOOVES},
        height={**every(SPINE, 1.2), "Neck1": 1.6, "Neck2": 1.1},
        bumps=(Bump("Head", (0.02, 0.08, -0.03), 0.014, (0.0, 0.06, 0.0)),),
        height_of_shoulder=3.0,
    ),
    "rhino": Species(
        length={**every(NECK, 0.8), "Head": 1.5, "Jaw": 1.3, "UpperArm": 0.75, "Forearm": 0.65, "Hand": 0.55,
                "Foot": 0.5, **every("Fingers Toes", 0.8), "Ear": 0.5, **every(TAIL, 0.5), **every(SPINE, 1.1)},
        width={"Head": 1.6, "Jaw": 1.5, **every(SPINE, 2.3), "Hips": 1.9, **every(NECK, 1.8), "Thigh": 1.5,
               "Shin": 1.7, "Foot": 2.1, "Toes": 1.5, "UpperArm": 1.5, "Forearm": 1.7, "Hand": 1.9, "Fingers": 1.4,
               "Ear": 0.8},
        height={"Head": 1.4, "Jaw": 1.3, **every(SPINE, 1.5), "Spine1": 1.9, "Spine2": 1.9, "Hips": 1.4,
                **every(NECK, 2.0)},
        bumps=(Bump("Head", (0.0, 0.045, 0.085), 0.02, (0.0, 0.1, 0.05)),),
        height_of_shoulder=1.7,
    ),
    "bear": Species(
        length={**every(NECK, 0.8), "Head": 0.95, "Jaw": 0.95, "UpperArm": 0.9, "Forearm": 0.8, "Hand": 0.5,
                "Foot": 0.5, "Shin": 0.85, "Ear": 0.4, **every(TAIL, 0.2), **every(SPINE, 1.1)},
        width={"Head": 1.5, "Jaw": 1.2, **every(SPINE, 1.9), "Hips": 1.6, **every(NECK, 1.8), "Thigh": 1.5, "Shin": 1.7,
               "Foot": 1.9, "Toes": 1.6, "UpperArm": 1.5, "Forearm": 1.8, "Hand": 1.9, "Fingers": 1.6, "Ear": 1.1},
        height={"Head": 1.3, **every(SPINE, 1.3), "Spine1": 1.7, "Spine2": 1.7, "Hips": 1.3, **every(NECK, 1.8)},
        height_of_shoulder=1.1,
    ),
}  # fmt: skip
"""Name -> species."""
