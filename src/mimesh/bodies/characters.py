"""A cast to try things with: people and stylised characters made from the shipped human, with clothes and colours."""

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


@dataclass(frozen=True)
class Role:
    """What one character is made of."""

    shape: tuple[float, ...] = ()
    """Shape coefficients of the human, in standard deviations."""
    lengths: Mapping[str, float] = field(default_factory=dict)
    """Factor on the length of a kind of bone, named as the joint it hangs from without its side."""
    girths: Mapping[str, float] = field(default_factory=dict)
    """Factor on all that is across such a bone."""
    size: float = 1.0
    garments: tuple[str, ...] = ()
    skin: Colour = (0.604, 0.342, 0.233)
    """Linear RGB in 0..1, as materials have it."""
    colours: Mapping[str, Colour] = field(default_factory=dict)
    """Of each garment."""


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
    """A member of the cast at rest, coloured, in metres and facing +z.

    Args:
        arms: 0 holds them out in a T, 1 lets them hang.

    Raises:
        InputError: no such member.
    """
    if name not in CHARACTERS:
        raise InputError(f"{name}: expected one of the cast ({', '.join(CHARACTERS)}), found another; name one of them")
    role = CHARACTERS[name]
    body = proportioned(dressed_body(load_body(), role.garments), role.lengths, role.girths, role.size)
    vertices = body.posed(np.array(role.shape), rotvec_to_rotmat(arms * lowered_arms(body)))
    mesh = dataclasses.replace(body.mesh(vertices - [0, vertices[:, 1].min(), 0]), name=name)
    return dataclasses.replace(mesh, parts=_parts(role, mesh))


def proportioned(
    body: RiggedBody, lengths: Mapping[str, float], girths: Mapping[str, float], size: float = 1.0
) -> RiggedBody:
    """The body with other bones, still standing on the floor; it keeps its shapes, weights and joints' names.

    Every joint scales what hangs from it by `lengths` along its bone and by `girths` across it, and carries the joints
    below along; where bones branch only girth counts. This is linear, so shape components go the same way.

    Raises:
        InputError: a kind of bone that the body has not.
    """
    direction, branching = bone_directions(body)
    along = np.where(branching[:, None, None], 0.0, direction[:, :, None] * direction[:, None])
    length, girth = (_by_joint(body, factors)[:, None, None] for factors in (lengths, girths))
    linear = size * (length * along + girth * (np.eye(3) - along))

    def grown(points: Float[np.ndarray, "V 3"], joints: Float[np.ndarray, "J 3"]):
        bones = joints[1:] - joints[list(body.parents[1:])]
        places = place_joints(size * joints[0], bones, linear, body.parents)
        offset = places - np.einsum("jab,jb->ja", linear, joints)
        return skin_points(points, body.weights, linear, offset), places

    vertices, joints = grown(body.vertices, body.joints)
    changes = [grown(*pair) for pair in zip(body.components, body.joint_components, strict=True)]
    floor = np.array([0.0, vertices[:, 1].min(), 0.0])
    return dataclasses.replace(
        body,
        vertices=vertices - floor,
        joints=joints - floor,
        components=np.stack([points for points, _ in changes]),
        joint_components=np.stack([places for _, places in changes]),
    )


def _by_joint(body: RiggedBody, factors: Mapping[str, float]) -> Float[np.ndarray, " J"]:
    """The factor of each joint's kind of bone; 1 where none is given."""
    kind = kinds_of_bones(body)
    found = np.ones(len(kind))
    for name, factor in factors.items():
        joint = next((j for j, own in enumerate(body.joint_names) if own in (name, f"Left{name}", f"L{name}")), None)
        if joint is None:
            raise InputError(f"{name}: expected a bone of {body.name}, found none of that name; see its joint_names")
        found[kind == kind[joint]] = factor
    return found


def _parts(role: Role, mesh: Mesh) -> tuple[Part, ...]:
    """One run of faces for the skin and one for each garment."""
    counts = [len(load_garment(name).faces) for name in role.garments]
    ends = np.cumsum([len(mesh.faces) - sum(counts), *counts])
    looks = (("skin", role.skin), *((name, role.colours[name]) for name in role.garments))
    starts = (0, *ends[:-1])
    return tuple(
        Part(name, int(start), int(stop), Material(name, (*colour, 1.0)))
        for (name, colour), start, stop in zip(looks, starts, ends, strict=True)
    )
