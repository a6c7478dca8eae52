"""Build src/mimesh/bodies/quadruped.npz from the dog of the registry package `dm_control` (Apache-2.0, DeepMind).

The package has a skinned dog: 16,952 vertices after welding, one closed surface, 57 bones. This script
1. merges its bones to 37 joints, gives it ears that move, and simplifies it to 6,890 vertices and 13,776 faces,
2. makes random animals of it: factors on the length and thickness of its bones, turns of its joints and bumps between
   those of two species (`quadruped_species.py`),
3. computes the principal components of the vertices, with joints by linear regression.

    pip download --no-deps dm_control==1.0.50
    python research/recipes/build_quadruped.py dm_control-1.0.50-py3-none-any.whl [-o src/mimesh/bodies/quadruped.npz]
    python research/recipes/build_quadruped.py dm_control-1.0.50-py3-none-any.whl --shapes horse lion camel
"""

from __future__ import annotations

import argparse
import struct
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import fast_simplification
import numpy as np
from body_components import on_ground, principal_components, residual_mm
from jaxtyping import Float
from quadruped_species import SPECIES, STANDING, Bump, Species
from save_body import save_body
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from mimesh.bodies.body_model import RiggedBody, load_body
from mimesh.bodies.quadruped import mean_posture
from mimesh.core.geometry import closest_on_mesh
from mimesh.core.skinning import place_joints, skin_points

SKIN = "dm_control/suite/dog_assets/dog_skin.skn"
"""File of the dog in the package: x front, y left, z up, metres."""
FACES = 13776
"""As many as the shipped human."""
AXES = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""Rotation from the dog's axes to y up, +z front; x is the animal's left."""
LEG = (
    *(("Scapula", "Chest", "scapula"), ("UpperArm", "Scapula", "upper_arm"), ("Forearm", "UpperArm", "lower_arm")),
    *(("Hand", "Forearm", "hand"), ("Fingers", "Hand", "finger")),
    *(
        ("Thigh", "Hips", "upper_leg"),
        ("Shin", "Thigh", "lower_leg"),
        ("Foot", "Shin", "foot"),
        ("Toes", "Foot", "toe"),
    ),
)
"""Joint, parent and bone of the dog, for both sides."""
CENTRE = {
    "Hips": ("", ["pelvis"]),
    "Spine1": ("Hips", ["L_7", "L_6", "L_5"]),
    "Spine2": ("Spine1", ["L_4", "L_3"]),
    "Spine3": ("Spine2", ["L_2", "L_1"]),
    "Spine4": ("Spine3", []),
    "Chest": ("Spine4", ["torso"]),
    "Neck1": ("Chest", ["C_7", "C_6"]),
    "Neck2": ("Neck1", ["C_5", "C_4"]),
    "Neck3": ("Neck2", ["C_3", "C_2", "C_1"]),
    "Head": ("Neck3", ["skull"]),
    "Jaw": ("Head", ["jaw"]),
    "LeftEar": ("Head", []),
    "RightEar": ("Head", []),
    **{f"Tail{i + 1}": (f"Tail{i}" if i else "Hips", [f"Ca_{k}" for k in range(*ends)])
       for i, ends in enumerate(((1, 4), (4, 8), (8, 11), (11, 15), (15, 18), (18, 22)))},
}  # fmt: skip
"""Joint -> parent and bones of the dog that it takes; its place is that of the first."""
PLACES = {"Spine4": (0.0, 0.51, -0.07), "Chest": (0.0, 0.51, 0.06), "LeftEar": (0.042, 0.755, 0.285)}
"""Places of joints that the dog lacks, and of the chest, whose bone the dog has in its middle."""
AXIS = {"Hips": (0, 0, 1), "Chest": (0, 0, 1), "Head": (0, -0.35, 1), "Jaw": (0, -0.45, 1)}
"""Directions of bones with several children, or of which the direction to the child is not that of the shape."""
VARIATION = 0.08
"""Standard deviation of an animal's own factors (of their logarithms), beside its two species'."""
SPREAD = {"Spine": 0.4, "Hips": 0.3, "Chest": 0.5, "Ear": 3.0, "Tail": 2.0, "Neck": 1.5, "Head": 1.5, "Scapula": 0.5,
          "Toes": 0.5, "Fingers": 0.5}  # fmt: skip
"""Kind of joint -> factor on them."""
SPINE = ("Hips", "Spine1", "Spine2", "Spine3", "Spine4", "Chest")
SIZE = 0.4
"""Mean distance of an animal's vertices from their centre (metres), about that of a large dog. All have one size,
because methods normalise the size of every mesh."""
BELOW_SPINE = 0.06
"""Metres from the joints of the spine down to the middle of the trunk, about which it gets thicker."""


class Parameters(NamedTuple):
    """An animal as numbers: logarithms of factors and turns of every joint, and how much of each species' bumps."""

    length: Float[np.ndarray, " J"]
    width: Float[np.ndarray, " J"]
    height: Float[np.ndarray, " J"]
    turn: Float[np.ndarray, "J 3"]
    """Rotation vectors (radians)."""
    bumps: Float[np.ndarray, " S"]
    size: float


def main() -> None:
    """Build the file and print how well it approximates the animals."""
    args = parse_args()
    dog = simplified(read_dog(args.package))
    if args.draw:
        draw_species(dog, args.draw)
        return
    if args.shapes:
        print_shapes(dog, load_body("quadruped"), args.shapes)
        return
    rng = np.random.default_rng(args.seed)
    species = [parameters(dog, one) for one in SPECIES.values()]
    animals, joints = zip(
        *(build_animal(dog, random_animal(dog, species, rng)) for _ in range(args.animals)), strict=True
    )
    body = components_of(dog, np.stack(animals), np.stack(joints), args.components)
    save_body(body, args.output)
    print(f"{args.output}: {args.output.stat().st_size / 1e6:.2f} MB, {len(body.vertices)} vertices, {FACES} faces")


def parse_args() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, help="the wheel of dm_control, or its .skn file")
    parser.add_argument("-o", "--output", type=Path, default=Path("src/mimesh/bodies/quadruped.npz"))
    parser.add_argument("--animals", type=int, default=2000)
    parser.add_argument("--components", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--draw", type=Path, metavar="DIR", help="write the species as OBJ files there, and no body")
    parser.add_argument("--shapes", nargs="+", choices=SPECIES, help="print shape coefficients of species, and no body")
    return parser.parse_args()


def read_dog(package: Path) -> RiggedBody:
    """Read the dog of the package with merged bones."""
    data = package.read_bytes() if package.suffix == ".skn" else zipfile.ZipFile(package).read(SKIN)
    vertices, faces, bones, places, weights = read_skin(data)
    if places[bones.index("upper_leg_L"), 0] < 0:
        raise ValueError("the left leg is on the right")
    centre = {name: (parent, taken) for name, (parent, taken) in CENTRE.items()}
    for side in ("Left", "Right"):
        for joint, parent, bone in LEG:
            above = parent if parent in CENTRE else f"{side}{parent}"
            centre[f"{side}{joint}"] = (above, [f"{bone}_{side[0]}"])
    names = sorted(centre, key=lambda name: (depth(name, centre), list(centre).index(name)))
    merged = np.stack([weights[:, [bones.index(bone) for bone in centre[name][1]]].sum(axis=1) for name in names], 1)
    joints = np.zeros((len(names), 3))
    for j, name in enumerate(names):
        mirrored = PLACES.get(name.replace("Right", "Left"))
        sign = (-1.0 if name.startswith("Right") else 1.0, 1.0, 1.0)
        joints[j] = np.array(mirrored) * sign if mirrored else places[bones.index(centre[name][1][0])]
    divide(merged, names, "Chest", "Spine4", 1.0 - ramp(vertices[:, 2], 0.0, 0.12))
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        ear = ramp(vertices[:, 1], 0.74, 0.765) * ramp(sign * vertices[:, 0], 0.012, 0.03)
        divide(merged, names, "Head", f"{side}Ear", ear * ramp(0.34 - vertices[:, 2], 0.0, 0.03))
    parents = tuple(names.index(centre[name][0]) if centre[name][0] else -1 for name in names)
    nothing = np.zeros((0, len(vertices), 3)), np.zeros((0, len(names), 3))
    return RiggedBody("dog", vertices, faces, nothing[0], joints, nothing[1], merged, tuple(names), parents)


def read_skin(data: bytes) -> tuple[np.ndarray, np.ndarray, list[str], np.ndarray, np.ndarray]:
    """Read a skin of MuJoCo: vertices welded by position, faces, bones, their places, and weights."""
    vertex_count, texture_count, face_count, bone_count = struct.unpack_from("<4i", data)
    at = 16
    vertices = np.frombuffer(data, "<f4", 3 * vertex_count, at).reshape(-1, 3).astype(float)
    at += 12 * vertex_count + 8 * texture_count
    faces = np.frombuffer(data, "<i4", 3 * face_count, at).reshape(-1, 3).astype(int)
    at += 12 * face_count
    names, places, weights = [], np.zeros((bone_count, 3)), np.zeros((vertex_count, bone_count))
    for bone in range(bone_count):
        names.append(data[at : at + 40].split(b"\0")[0].decode())
        places[bone] = np.frombuffer(data, "<f4", 3, at + 40)
        (count,) = struct.unpack_from("<i", data, at + 68)
        index = np.frombuffer(data, "<i4", count, at + 72)
        weights[index, bone] = np.frombuffer(data, "<f4", count, at + 72 + 4 * count)
        at += 72 + 8 * count
    _, first, welded = np.unique(vertices.round(6), axis=0, return_index=True, return_inverse=True)
    faces = welded.ravel()[faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    weights = weights[first]
    return vertices[first] @ AXES.T, faces[whole], names, places @ AXES.T, weights / weights.sum(axis=1, keepdims=True)


def depth(name: str, tree: dict[str, tuple[str, list[str]]]) -> int:
    """Count the joints above one."""
    return 0 if not name else 1 + depth(tree[name][0], tree) if tree[name][0] else 0


def ramp(x: Float[np.ndarray, " V"], low: float, high: float) -> Float[np.ndarray, " V"]:
    """Rise smoothly from 0 to 1 between two values."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def divide(weights: np.ndarray, names: list[str], old: str, new: str, share: Float[np.ndarray, " V"]) -> None:
    """Give a share of one joint's weights to another, in place."""
    source = weights[:, names.index(old)]
    weights[:, names.index(new)] += share * source
    source *= 1.0 - share


def simplified(body: RiggedBody) -> RiggedBody:
    """Simplify a body to FACES; weights follow by the nearest points of the surface."""
    fine: Any = body.vertices.astype(np.float32)  # its stub asks for float64, which it takes too
    points, faces, *_ = fast_simplification.simplify(fine, body.faces.astype(np.int32), target_count=FACES)
    nearest, barycentric, _ = closest_on_mesh(points.astype(float), body.vertices, body.faces)
    weights = np.einsum("vkj,vk->vj", body.weights[body.faces[nearest]], barycentric)
    nothing = np.zeros((0, len(points), 3))
    return RiggedBody(body.name, points.astype(float), faces.astype(np.int64), nothing, body.joints,
                      body.joint_components, weights, body.joint_names, body.parents)  # fmt: skip


def bare(name: str) -> str:
    """Give the name of a joint without its side."""
    return name.removeprefix("Left").removeprefix("Right")


def parameters(dog: RiggedBody, species: Species) -> Parameters:
    """Turn a species into numbers for every joint."""
    kinds = [bare(name) for name in dog.joint_names]
    length, width = ([np.log(table.get(kind, 1.0)) for kind in kinds] for table in (species.length, species.width))
    height = [np.log(species.height.get(kind, species.width.get(kind, 1.0))) for kind in kinds]
    # All animals rest in one posture, so that what a shape has and what a pose has can be told apart.
    mean = mean_posture()
    pitch = [mean.get(kind, (0.0, 0.0))[0] + STANDING.get(kind, 0.0) for kind in kinds]
    sides = [-1.0 if name.startswith("Right") else 1.0 for name in dog.joint_names]
    roll = [side * mean.get(kind, (0.0, 0.0))[1] for kind, side in zip(kinds, sides, strict=True)]
    turn = np.radians(np.stack([pitch, np.zeros(len(kinds)), roll], axis=1))
    bumps = np.array([float(other is species) for other in SPECIES.values()])
    factors = np.array(length), np.array(width), np.array(height)
    return Parameters(*factors, turn, bumps, float(np.log(species.height_of_shoulder)))


def random_animal(dog: RiggedBody, species: list[Parameters], rng: np.random.Generator) -> Parameters:
    """Draw an animal between two species, with variations of its own: the same on both sides."""
    first, second = (species[i] for i in rng.integers(len(species), size=2))
    t = rng.beta(0.6, 0.6)
    mixed = Parameters._make((1 - t) * np.asarray(a) + t * np.asarray(b) for a, b in zip(first, second, strict=True))
    kinds = [bare(name) for name in dog.joint_names]
    spread = np.array([next((s for part, s in SPREAD.items() if kind.startswith(part)), 1.0) for kind in kinds])
    same = np.unique(kinds, return_inverse=True)[1]
    length, width, height = (VARIATION * spread * rng.normal(size=len(kinds))[same] for _ in range(3))
    return mixed._replace(
        length=mixed.length + length,
        width=mixed.width + width,
        height=mixed.height + (width + height) / np.sqrt(2.0),
    )


def build_animal(dog: RiggedBody, animal: Parameters) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "J 3"]]:
    """Make an animal's vertices and joints at rest: standing on y = 0, front and hind feet, facing +z.

    The hind legs are made as long as they must be for all feet to stand on the ground.
    """
    at = dog.joint_names.index
    front, hind = (
        dog.weights[:, [at(f"Left{name}"), at(f"Right{name}")]].sum(axis=1) > 0.5 for name in ("Fingers", "Toes")
    )
    legs = [at(f"{side}{name}") for side in ("Left", "Right") for name in ("Thigh", "Shin", "Foot")]

    def gap(factor: float) -> float:
        vertices, _ = deform(dog, lengthened(animal, legs, factor))
        return vertices[hind, 1].min() - vertices[front, 1].min()

    factor = float(np.asarray(brentq(gap, -2.5, 2.5, xtol=1e-3)))
    vertices, joints = deform(dog, lengthened(animal, legs, factor))
    ground = np.array([0.0, vertices[front, 1].min(), 0.0])
    scale = np.exp(animal.size) / (joints[at("LeftScapula"), 1] - ground[1])
    return scale * (vertices - ground), scale * (joints - ground)


def lengthened(animal: Parameters, joints: list[int], factor: float) -> Parameters:
    """Add to the logarithm of some bones' lengths."""
    length = animal.length.copy()
    length[joints] += factor
    return animal._replace(length=length)


def deform(dog: RiggedBody, animal: Parameters) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "J 3"]]:
    """Scale and turn the dog's bones, after its skin got its bumps."""
    vertices = bumped(dog, animal.bumps)
    linear = np.zeros((len(dog.joints), 3, 3))
    world = np.zeros_like(linear)
    axes = bone_axes(dog)
    turns = Rotation.from_rotvec(animal.turn).as_matrix()
    for j, parent in enumerate(dog.parents):
        world[j] = (world[parent] if parent >= 0 else np.eye(3)) @ turns[j]
        across = np.array([1.0, 0, 0]) - axes[j, 0] * axes[j]
        across /= np.linalg.norm(across)
        frame = np.stack([axes[j], across, np.cross(axes[j], across)], axis=1)
        factors = np.exp([animal.length[j], animal.width[j], animal.height[j]])
        linear[j] = world[j] @ (frame * factors) @ frame.T
    bones = dog.joints[1:] - dog.joints[list(dog.parents[1:])]
    joints = place_joints(dog.joints[0], bones, linear, dog.parents)
    # The trunk gets thicker about its middle, which lies below the joints of its spine.
    middle = np.zeros_like(joints)
    middle[[dog.joint_names.index(name) for name in SPINE], 1] = -BELOW_SPINE
    offset = joints - np.einsum("jab,jb->ja", linear, dog.joints + middle) + np.einsum("jab,jb->ja", world, middle)
    return skin_points(vertices, dog.weights, linear, offset), joints


def bumped(dog: RiggedBody, shares: Float[np.ndarray, " S"]) -> Float[np.ndarray, "V 3"]:
    """Displace the dog's vertices by shares of all species' bumps."""
    vertices = dog.vertices
    for share, species in zip(shares, SPECIES.values(), strict=True):
        for bump in species.bumps if share else ():
            for side in (1.0, -1.0) if bump.offset[0] else (1.0,):
                vertices = vertices + share * pushed(dog, vertices, bump, np.array([side, 1.0, 1.0]))
    return vertices


def pushed(dog: RiggedBody, vertices: np.ndarray, bump: Bump, side: np.ndarray) -> Float[np.ndarray, "V 3"]:
    """Compute the displacement of a bump."""
    centre = dog.joints[dog.joint_names.index(bump.joint)] + side * bump.offset
    near = np.exp(-((vertices - centre) ** 2).sum(axis=1) / bump.radius**2)
    return near[:, None] * (side * bump.push)


def bone_axes(dog: RiggedBody) -> Float[np.ndarray, "J 3"]:
    """Compute the direction of each bone at rest."""
    axes = np.zeros_like(dog.joints)
    for j, name in enumerate(dog.joint_names):
        below = [c for c, parent in enumerate(dog.parents) if parent == j]
        weight = dog.weights[:, j]
        end = dog.joints[below[0]] if below else weight @ dog.vertices / weight.sum()
        axes[j] = AXIS.get(name, end - dog.joints[j])
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def draw_species(dog: RiggedBody, folder: Path) -> None:
    """Write each species as an OBJ file."""
    import trimesh

    folder.mkdir(parents=True, exist_ok=True)
    for name, species in SPECIES.items():
        vertices, _ = build_animal(dog, parameters(dog, species))
        trimesh.Trimesh(vertices, dog.faces, process=False).export(folder / f"{name}.obj")


def print_shapes(dog: RiggedBody, body: RiggedBody, names: list[str], count: int = 12) -> None:
    """Print the coefficients of a body's first components that are nearest to species, and how far they are (mm)."""
    for name in names:
        vertices, joints = build_animal(dog, parameters(dog, SPECIES[name]))
        size = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).mean() / SIZE
        (vertices,), _ = on_ground(vertices[None] / size, joints[None] / size)
        components = body.components[:count].reshape(count, -1)
        shape = np.linalg.lstsq(components.T, (vertices - body.vertices).ravel())[0].round(1)
        off = 1000 * np.linalg.norm(body.shaped(shape)[0] - vertices, axis=1)
        print(f"{name}: {shape.tolist()}, {off.mean():.1f} mm away, {off.max():.0f} mm at most")


def components_of(dog: RiggedBody, animals: Float[np.ndarray, "N V 3"], joints: np.ndarray, count: int) -> RiggedBody:
    """Make a body of animals of one size: their mean and principal components. Print how well these give them back."""
    size = np.linalg.norm(animals - animals.mean(axis=1, keepdims=True), axis=2).mean(axis=1)[:, None, None] / SIZE
    animals, joints = on_ground(animals / size, joints / size)
    mean, joint_mean, components, joint_components = principal_components(animals, joints, count)
    for k in (8, 16, count):
        rest = residual_mm(animals, mean, components[:k])
        print(f"{k} components: residual {rest.mean():.1f} mm, of the worst animal {rest.max():.1f} mm")
    return RiggedBody("quadruped", mean, dog.faces, components, joint_mean, joint_components, dog.weights,
                      dog.joint_names, dog.parents)  # fmt: skip


if __name__ == "__main__":
    main()
