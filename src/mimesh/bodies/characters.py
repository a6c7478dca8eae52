"""Characters for demos and figures: the shipped human with other proportions, garments and colours."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.mesh import Material, Mesh, Part
from ..core.skinning import place_joints, skin_points
from .body_model import RiggedBody, load_body
from .dress import dressed_body, load_garment
from .sampled_body import bone_directions, kinds_of_bones
from .sampling import lowered_arms, rotvec_to_rotmat

Colour = tuple[float, float, float]
"""Linear RGB in 0..1."""


@dataclass(frozen=True)
class Role:
    """Definition of a character: shape, proportions, garments and colours."""

    shape: tuple[float, ...] = ()
    """Shape coefficients of the human, in standard deviations."""
    lengths: Mapping[str, float] = field(default_factory=dict)
    """Factor on the length of the bones from a joint, by the joint's name without its side."""
    girths: Mapping[str, float] = field(default_factory=dict)
    """Factor on the thickness of these bones."""
    size: float = 1.0
    """Factor on all lengths."""
    garments: tuple[str, ...] = ()
    skin: Colour = (0.604, 0.342, 0.233)
    colours: Mapping[str, Colour] = field(default_factory=dict)
    """Colour of each garment."""


CHARACTERS: dict[str, Role] = {
    "slim": Role(
        shape=(1.6, -0.4, 1.8, -1.4),
        garments=("tights",),
        skin=(0.100, 0.033, 0.017),
        colours={"tights": (0.214, 0.296, 0.196)},
    ),
    "heavy": Role(
        shape=(-1.9, 0.2, -2.2, 2.2),
        girths={"LowerBack": 1.16, "Spine": 1.12, "UpLeg": 1.1, "Arm": 1.12},
        garments=("tights",),
        skin=(0.711, 0.448, 0.319),
        colours={"tights": (0.342, 0.095, 0.059)},
    ),
    "child": Role(
        shape=(0.4, -1.6, 0.6),
        lengths={"UpLeg": 0.82, "Leg": 0.80, "Arm": 0.84, "ForeArm": 0.82, "Head": 1.12},
        girths={"Head": 1.12, "Spine1": 0.9, "UpLeg": 0.94},
        size=0.68,
        garments=("tights",),
        colours={"tights": (0.787, 0.342, 0.055)},
    ),
    "dancer": Role(
        shape=(0.9, 0.2, 1.0, -0.6),
        garments=("tights", "skirt", "hair"),
        colours={"tights": (0.033, 0.040, 0.059), "skirt": (0.448, 0.033, 0.051), "hair": (0.047, 0.022, 0.013)},
    ),
    "runner": Role(
        shape=(0.6, 1.0, 0.2, 0.8),
        garments=("tights",),
        skin=(0.171, 0.078, 0.047),
        colours={"tights": (0.025, 0.171, 0.214)},
    ),
    "imp": Role(
        shape=(0.2, -1.4, 0.5),
        lengths={"UpLeg": 0.62, "Leg": 0.62, "Arm": 0.9, "Head": 1.55, "Neck": 0.8},
        girths={"Head": 1.6, "Hand": 1.5, "FingerBase": 1.3, "Foot": 1.45, "ToeBase": 1.4, "Leg": 1.12, "Spine1": 0.95},
        size=0.8,
        skin=(0.214, 0.367, 0.179),
    ),
    "brute": Role(
        shape=(-0.8, -1.8, -0.4, 1.8),
        lengths={"UpLeg": 0.85, "Leg": 0.85, "Arm": 1.15, "ForeArm": 1.1},
        girths={"Spine1": 1.45, "Spine": 1.25, "Arm": 1.5, "ForeArm": 1.55, "Hand": 1.35, "Head": 0.88, "UpLeg": 1.15},
        size=1.15,
        garments=("tights",),
        skin=(0.342, 0.393, 0.477),
        colours={"tights": (0.119, 0.147, 0.233)},
    ),
    "stork": Role(
        shape=(1.4, -0.8, 1.4),
        lengths={"UpLeg": 1.3, "Leg": 1.35, "Arm": 1.2, "ForeArm": 1.25, "Neck": 1.3},
        girths={"UpLeg": 0.82, "Leg": 0.8, "Arm": 0.8, "ForeArm": 0.8, "Spine1": 0.9},
        skin=(0.507, 0.342, 0.477),
    ),
}
"""slim, heavy, child, dancer and runner are people; imp, brute and stork are stylised."""


def character(name: str, arms: float = 0.6) -> Mesh:
    """Build the mesh of a character at rest, coloured, in metres, standing on y = 0 and facing +z.

    Args:
        arms: 0 for a T-pose, 1 for lowered arms (see `lowered_arms`).

    Raises:
        InputError: no character has this name.
    """
    if name not in CHARACTERS:
        raise InputError(f"{name}: expected a character ({', '.join(CHARACTERS)}), found another name; use one of them")
    role = CHARACTERS[name]
    body = proportioned(dressed_body(load_body(), role.garments), role.lengths, role.girths, role.size)
    vertices = body.posed(np.array(role.shape), rotvec_to_rotmat(arms * lowered_arms(body)))
    mesh = dataclasses.replace(body.mesh(vertices - [0, vertices[:, 1].min(), 0]), name=name)
    return dataclasses.replace(mesh, parts=_parts(role, mesh))


def proportioned(
    body: RiggedBody, lengths: Mapping[str, float], girths: Mapping[str, float], size: float = 1.0
) -> RiggedBody:
    """Scale the bones of a body, which stays on the floor; shape components, weights and joint names are kept.

    Every joint scales the vertices weighted to it by `lengths` along its bone and by `girths` across it, and moves its
    descendants along; where bones branch, girth scales all directions. The scaling is linear in the vertices and
    joints, so it is applied to the shape components too.
    """
    direction, branching = bone_directions(body)
    # Projection onto each bone's direction; zero where bones branch.
    along = np.where(branching[:, None, None], 0.0, direction[:, :, None] * direction[:, None])
    length, girth = (_joint_factors(body, factors)[:, None, None] for factors in (lengths, girths))
    linear = size * (length * along + girth * (np.eye(3) - along))

    def scaled(points: Float[np.ndarray, "V 3"], joints: Float[np.ndarray, "J 3"]):
        bones = joints[1:] - joints[list(body.parents[1:])]
        positions = place_joints(size * joints[0], bones, linear, body.parents)
        # Each joint's map takes its old position to the new one.
        offset = positions - np.einsum("jab,jb->ja", linear, joints)
        return skin_points(points, body.weights, linear, offset), positions

    vertices, joints = scaled(body.vertices, body.joints)
    components = [scaled(*pair) for pair in zip(body.components, body.joint_components, strict=True)]
    floor = np.array([0.0, vertices[:, 1].min(), 0.0])
    return dataclasses.replace(
        body,
        vertices=vertices - floor,
        joints=joints - floor,
        components=np.stack([points for points, _ in components]),
        joint_components=np.stack([positions for _, positions in components]),
    )


def _joint_factors(body: RiggedBody, factors: Mapping[str, float]) -> Float[np.ndarray, " J"]:
    kind = kinds_of_bones(body)
    result = np.ones(len(kind))
    for name, factor in factors.items():
        joint = next(
            (j for j, known in enumerate(body.joint_names) if known in (name, f"Left{name}", f"L{name}")), None
        )
        if joint is None:
            raise InputError(f"{name}: expected a bone of {body.name}, found none of that name; see its joint_names")
        result[kind == kind[joint]] = factor
    return result


def _parts(role: Role, mesh: Mesh) -> tuple[Part, ...]:
    # Faces of a dressed body: its own first, then each garment's in order (`dressed_body`).
    counts = [len(load_garment(name).faces) for name in role.garments]
    ends = np.cumsum([len(mesh.faces) - sum(counts), *counts])
    colours = (("skin", role.skin), *((name, role.colours[name]) for name in role.garments))
    starts = (0, *ends[:-1])
    return tuple(
        Part(name, int(start), int(stop), Material(name, (*colour, 1.0)))
        for (name, colour), start, stop in zip(colours, starts, ends, strict=True)
    )
