"""Measure hands that touch the own body: contact error and penetration, as MeshRet does (Ye et al., NeurIPS 2024).

    python research/measure_contacts.py POOL [-o benchmarks/contacts.json] [--characters 8] [--clips 2]
    python research/measure_contacts.py --picture docs/gallery/contacts.webp

POOL is a pool of rigged characters; those of its splits train and val follow everyday contacts of the shipped body
(EVERYDAY) and clips of the pool of other makers, with contacts and without ("copied directions").

Contact error: of each hand of the driving some share is within 2 cm of another part; it is the mean distance from the
same part of the identity, of as large a share of its hand. Penetration: share of the surface of hands and forearms that
is inside trunk, head or legs. Lengths are in centimetres of a person whose arm has 53 cm, as it has at 1.75 m.

Constants of the tool are chosen on the split train. Characters that the tool leaves as they are, as their arms have no
wrists, are a group of their own.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from retargets import FPS, body_limbs, choose_characters, write_pool
from scipy.spatial import KDTree

from mimesh.bodies import character as shipped_character
from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.character_pool import CharacterMeta, PoolCharacter, read_pool
from mimesh.bodies.contacts import contact_bank
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.commands.terminal import progress
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.options import MotionOptions
from mimesh.core.surface_points import SurfacePoints, generator
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import load_clip, load_mesh
from mimesh.io.atomic import whole_file
from mimesh.motions.motion import Motion
from mimesh.motions.on_body import played
from mimesh.pipeline import animate
from mimesh.rigs.body_grid import part_of_joint
from mimesh.view.movie import clip_frames
from mimesh.view.sheet import DRIVING_TINT, page

ARM = ("Shoulder", "Arm", "ForeArm", "Hand")
EVERYDAY: dict[str, list[tuple[float, float, float]]] = {
    "hands on hips": [(0.13, 0.36, 0.12), (0.59, -0.17, -1.15), (0.35, -1.58, -0.23), (0.16, 0.5, 0.18)],
    "on belly": [(0.17, -0.08, 0.18), (0.5, -0.47, -1.09), (0.24, -1.73, -0.18), (-0.01, -0.18, -0.3)],
    "on chest": [(0.18, -0.06, 0.42), (0.31, -0.59, -0.89), (0.24, -2.25, -0.04), (-0.44, -0.24, -0.09)],
    "on cheeks": [(-0.15, 0.04, -0.32), (-0.36, -1.34, -1.46), (0.26, -2.16, 0.02), (0.23, -0.1, 0.44)],
    "on back": [(0.11, 0.34, -0.04), (0.73, 0.72, -1.66), (-0.15, -1.57, -0.18), (-0.23, 0.27, 0.78)],
    "on thighs": [(0.14, -0.42, -0.24), (0.42, -0.44, -1.06), (0.43, -0.39, -0.14), (0.32, 0.25, -0.05)],
    "on knees": [(0.04, -0.34, -0.22), (0.27, -0.52, -0.77), (0.51, -0.82, 0.14), (0.49, 0.25, 0.05)],
    "on head": [(-0.14, 0.3, 0.48), (-1.23, -0.73, -0.23), (-0.23, -2.33, 0.2), (0.56, -0.19, 0.29)],
    "clap": [(0.01, -0.22, -0.29), (-0.19, -1.11, -0.71), (-0.17, -0.88, 0.1), (-0.11, 0.05, 0.2)],
}
"""Rotation vectors (radians) of the joints ARM of the left arm, of the right arm mirrored. A palm of the shipped body
lies on the part, at most 1.5 cm deep; least squares made them."""
SEATED = {"UpLeg": (-1.4, 0.0, 0.0), "Leg": (1.5, 0.0, 0.0)}
"""Legs of those with their hands on their knees."""
DRAWN, TILE = ("hands on hips", "on belly", "on chest", "on cheeks", "on thighs"), (240, 320)
"""Contacts in the picture, and the size of each in pixels."""
HELD = 13
"""Frames for which each of them is held, six standard deviations of the filter over corrections and more."""
SAMPLES, SEED = 8000, 0
POOL_FRAMES = 4
"""Frames of a clip of the pool, evenly spread, that are measured."""
TOUCHES, SURFACE, STRAIGHT = 2.0, 0.5, 0.5
"""Centimetres: distance of a hand that touches; depth from which on a point is inside. Least cosine between the normal
of the nearest sample and the way there from a point inside: where arms are cut off a body its surface has an edge, and
a point beyond that is not inside."""
ARM_CM = 53.0
BANK, SHAPES = 200, 3
"""People of the shipped body among which the thinnest and the fattest are chosen, and how many of each."""
LEVELS = 3
"""Parts of a trunk, one above the other."""
GIRTHS = {"thin": (0.0, 0.45), "medium": (0.45, 0.58), "fat": (0.58, np.inf)}
"""Girth of the trunk at half its height over the height of the person."""


@dataclass(frozen=True, eq=False)
class Person:
    """Samples of a person's surface, with the part that each is on."""

    surface: SurfacePoints
    part: np.ndarray
    """Part of each sample: Head, Trunk0, LeftUpLeg, LeftHand, ..."""
    unit: float
    """Length of a centimetre in the file's unit."""

    @classmethod
    def of(cls, mesh: Mesh, joint: Float[np.ndarray, " V"], names: list[str], places: dict[str, np.ndarray]) -> Person:
        """Sample a person at rest.

        Args:
            joint: strongest joint of each vertex.
            names: joint of the shipped body that each joint is or is below.
            places: positions of the joints of the shipped body.
        """
        surface = SurfacePoints.of(mesh, SAMPLES, generator(SEED, 0))
        strongest = surface.barycentric.argmax(axis=1)
        of_joint = np.array([part_of_joint(name) for name in names])
        part = of_joint[joint[surface.corners[np.arange(SAMPLES), strongest]]].astype(object)
        points = surface.points(mesh.vertices)
        low, high = (np.mean([places[f"{s}{name}"][1] for s in SIDES]) for name in ("UpLeg", "Arm"))
        level = np.clip((points[:, 1] - low) / (high - low) * LEVELS, 0, LEVELS - 1).astype(int)
        part = np.where(part == "Trunk", np.char.add("Trunk", level.astype(str)).astype(object), part)
        arm = 0.0
        for side in SIDES:
            upper, fore, wrist = (places[f"{side}{name}"] for name in ("Arm", "ForeArm", "Hand"))
            prop = np.linalg.norm(points - wrist, axis=1) > np.linalg.norm(wrist - fore)
            part[(part == f"{side}Hand") & prop] = ""
            if not (part == f"{side}Hand").any():  # forearms of blocks end in hands
                part[
                    (part == f"{side}ForeArm") & ((points - fore) @ (wrist - fore) > 0.75 * np.sum((wrist - fore) ** 2))
                ] = f"{side}Hand"
            arm += (np.linalg.norm(fore - upper) + np.linalg.norm(wrist - fore)) / 2
        return cls(surface, part.astype(str), float(arm) / ARM_CM)

    def posed(self, vertices: Float[np.ndarray, "V 3"]) -> Posed:
        """Return the samples in a frame."""
        return Posed(self, self.surface.points(vertices) / self.unit, self.surface.normals(vertices))


@dataclass(frozen=True, eq=False)
class Posed:
    """A person in a frame (centimetres)."""

    person: Person
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]

    def distances(self, side: str) -> dict[str, Float[np.ndarray, " M"]]:
        """Measure the distances of the points of a hand from each part that it may touch, the smallest first."""
        part = self.person.part
        hand = self.points[part == f"{side}Hand"]
        others = [name for name in np.unique(part) if name and name.removeprefix(side) not in ARM]
        return {name: np.sort(KDTree(self.points[part == name]).query(hand)[0]) for name in others if len(hand)}

    def penetration(self) -> float:
        """Measure the share of hands and forearms that is inside trunk, head or legs."""
        part = self.person.part
        arms = np.isin(part, [f"{side}{name}" for side in SIDES for name in ("ForeArm", "Hand")])
        body = np.flatnonzero([name.startswith(("Trunk", "Head")) or name.endswith("Leg") for name in part])
        nearest = body[KDTree(self.points[body]).query(self.points[arms])[1]]
        way = self.points[nearest] - self.points[arms]
        depth = (way * self.normals[nearest]).sum(axis=1)
        return float(((depth > SURFACE) & (depth > STRAIGHT * np.linalg.norm(way, axis=1))).mean())


@dataclass(frozen=True, eq=False)
class Driving:
    """A clip that is followed."""

    maker: str
    """Maker of its character; "everyday" for the everyday contacts."""
    name: str
    clip: Clip
    person: Person
    frames: list[int]
    """Frames that are measured."""

    @cached_property
    def posed(self) -> list[Posed]:
        """The person in these frames."""
        return [self.person.posed(np.asarray(self.clip.vertices[t], float)) for t in self.frames]

    @cached_property
    def distances(self) -> list[dict[str, Float[np.ndarray, " M"]]]:
        """Distances of both hands in each frame, as of `Posed.distances`."""
        return [posed.distances(side) for posed in self.posed for side in SIDES]

    @cached_property
    def touched(self) -> list[dict[str, float]]:
        """Share of each hand in each frame that is near each part that it touches."""
        return [
            {part: float((apart < TOUCHES).mean()) for part, apart in of.items() if apart[0] < TOUCHES}
            for of in self.distances
        ]

    @cached_property
    def penetration(self) -> float:
        """Mean penetration."""
        return float(np.mean([posed.penetration() for posed in self.posed]))

    def contact(self, distances: list[dict[str, Float[np.ndarray, " M"]]]) -> float | None:
        """Compute the contact error of hands with these distances; None where the driving touches nothing."""
        apart = [
            of[part][: max(1, round(share * len(of[part])))].mean()
            for parts, of in zip(self.touched, distances, strict=True)
            for part, share in parts.items()
            if part in of
        ]
        return float(np.mean(apart)) if apart else None


def main() -> None:
    """Measure all pairs and write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path, nargs="?")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="only draw some contacts on a shipped character")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/contacts.json"))
    parser.add_argument("--characters", type=int, default=8, help="of each split")
    parser.add_argument("--clips", type=int, default=2, help="of the pool, for each character")
    args = parser.parse_args()
    if args.picture:
        draw(args.picture)
        return
    if args.pool is None:
        parser.error("expected POOL or --picture FILE")
    pool = [character for split in ("train", "val") for character in read_pool(args.pool, split).characters]
    pool = [c for c in pool if {f"{s}{name}" for s in SIDES for name in ("Arm", "ForeArm", "Hand")} <= c.joints.keys()]
    splits = [tuple(c for c in pool if c.meta.split == split) for split in ("train", "val")]
    chosen = [c for split in splits for c in choose_characters(split, args.characters)] + shaped_people(SHAPES)
    rows: list[dict[str, Any]] = []
    drivings = everyday_contacts()
    with tempfile.TemporaryDirectory() as folder, progress("characters", quiet=False) as advance:
        players = choose_characters(tuple(c for c in pool if c.clips), 6)
        paths = write_pool([*{c.meta.file: c for c in (*chosen, *players)}.values()], Path(folder))
        for player in players:
            for clip in list(player.clips)[:: max(1, len(player.clips) // 2)][:2]:
                loaded = load_clip(paths[player.meta.file], animation=clip)
                frames = np.linspace(0, len(loaded) - 1, POOL_FRAMES).round().astype(int).tolist()
                name = f"{player.meta.file} {clip}"
                drivings.append(Driving(player.meta.maker, name, loaded, person_of(player), frames))
        for k, character in enumerate(chosen):
            others = [driving for driving in drivings if driving.maker not in ("everyday", character.meta.maker)]
            used = [driving for driving in drivings if driving.maker == "everyday"] + others[k % 2 :: 2][: args.clips]
            mesh, mine = load_mesh(paths[character.meta.file]), person_of(character)
            rows += measure_character(character, mesh, mine, used)
            if advance is not None:
                advance(k + 1, len(chosen))
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "seed": SEED}
    report |= {"characters": len(chosen), "clips": args.clips, "pairs": len(rows), "results": summary(rows)}
    with whole_file(args.output) as path:
        path.write_text(json.dumps(report | {"figures": rows}, indent=1) + "\n")
    print(json.dumps(report["results"], indent=1))


def draw(path: Path) -> None:
    """Draw contacts of the shipped body, and a heavy character that follows them without and with contacts."""
    driving, heavy = everyday_contacts()[0].clip, shipped_character("heavy")
    rows = [driving]
    rows += [animate(heavy, driving, motion=MotionOptions(contacts=contacts)).clip for contacts in (False, True)]
    tiles = []
    for clip, tint in zip(rows, (DRIVING_TINT, None, None), strict=True):
        for name in DRAWN:
            still = clip.mesh.with_vertices(clip.vertices[HELD * list(EVERYDAY).index(name) + HELD // 2])
            shot = next(clip_frames([("", Clip.still(still))], TILE, tints=[tint]))
            tiles.append(shot.crop((0, 0, *TILE)))
    with whole_file(path) as temporary:
        page(tiles, len(DRAWN)).save(temporary, format="WEBP", quality=82, method=6)
    print(f"{path}: {path.stat().st_size / 1024:.0f} KiB")


def shaped_people(count: int) -> list[PoolCharacter]:
    """Return the thinnest and the fattest shapes among people of the shipped body (`bodies.contacts`), as many each."""
    body, rig = load_body(), body_limbs().character
    found = []
    for k, shape in enumerate(contact_bank()[0][:BANK]):
        points, joints = body.shaped(shape)
        frames = rig.T_world_joint.copy()
        frames[:, :3, 3] = joints
        mesh, points = body.mesh(points), np.broadcast_to(points[:, None], rig.points.shape)
        meta = CharacterMeta(f"body_{k}", "shipped body", "", "", "realistic", "humanoid", "", "+z", "")
        own = dataclasses.replace(rig, mesh=mesh, T_world_joint=frames, points=points)
        places = {name: j for j, name in enumerate(body.joint_names)}
        found.append(PoolCharacter(meta, own, places, {}, {}, body.parents, np.arange(len(body.parents))))
    strongest = body.weights.argmax(axis=1)
    waist = np.isin(strongest, [body.joint(name) for name in ("LowerBack", "Spine")])
    found.sort(
        key=lambda c: np.ptp(c.rig.mesh.vertices[waist][:, [0, 2]], axis=0).sum() / np.ptp(c.rig.mesh.vertices[:, 1])
    )
    every = 4  # neighbours in this order are alike
    chosen = found[: every * count : every] + found[: -every * count - 1 : -every]
    return [
        dataclasses.replace(c, meta=dataclasses.replace(c.meta, split=("train", "val")[k % 2]))
        for k, c in enumerate(chosen)
    ]


def everyday_contacts() -> list[Driving]:
    """Make the everyday contacts of the shipped body, one after the other in one clip of 30 frames a second."""
    body = load_body()
    poses = np.zeros((len(EVERYDAY), len(body.joint_names), 3))
    for pose, (name, vectors) in zip(poses, EVERYDAY.items(), strict=True):
        for side, sign in zip(SIDES, (1, -1), strict=True):
            for joint, vector in zip(ARM, vectors, strict=True):
                pose[body.joint(f"{side}{joint}")] = np.array(vector) * (1, sign, sign)
            if name == "on knees":
                for joint, vector in SEATED.items():
                    pose[body.joint(f"{side}{joint}")] = vector
    rotation = np.repeat(rotvec_to_rotmat(poses), HELD, axis=0)
    clip = played(Motion("everyday", body.joint_names, rotation, np.zeros((len(rotation), 3)), FPS), "+z")
    places = dict(zip(body.joint_names, body.joints, strict=True))
    person = Person.of(body.mesh(), body.weights.argmax(axis=1), list(body.joint_names), places)
    return [Driving("everyday", name, clip, person, [HELD * k + HELD // 2]) for k, name in enumerate(EVERYDAY)]


def person_of(character: PoolCharacter) -> Person:
    """Return the surface of a character of the pool."""
    rig, names = character.rig, {joint: name for name, joint in reversed(character.joints.items())}
    nearest = []
    for j, parent in enumerate(rig.parents):
        nearest.append(names.get(j, nearest[parent] if parent >= 0 else "Hips"))
    strongest = np.take_along_axis(rig.joint_of, rig.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    places = {name: rig.T_world_joint[joint, :3, 3] for name, joint in character.joints.items()}
    return Person.of(rig.mesh, strongest.clip(max=len(nearest) - 1), nearest, places)


def girth(character: PoolCharacter, person: Person) -> float:
    """Measure the girth of the trunk at half its height, of an ellipse, over the height of the person."""
    points = person.surface.points(character.rig.mesh.vertices)
    waist = points[person.part == "Trunk1"]
    width, depth = np.ptp(np.percentile(waist[:, [0, 2]], (5, 95), axis=0), axis=0) / 2
    return float(np.pi * (width + depth) / np.ptp(points[:, 1]))


def measure_character(
    character: PoolCharacter, mesh: Mesh, mine: Person, drivings: list[Driving]
) -> list[dict[str, Any]]:
    """Measure clips on one character, with their directions copied and with contacts; feet are not planted."""
    rows, moved = [], {}
    about = {"identity": character.meta.file, "pack": character.meta.pack, "split": character.meta.split}
    about["girth"] = round(girth(character, mine), 3)
    for driving in drivings:
        row: dict[str, Any] = about | {"driving": driving.name, "everyday": driving.maker == "everyday"}
        row |= {"touches": sum(map(len, driving.touched)), "contact driving": driving.contact(driving.distances)}
        row["penetration driving"] = driving.penetration
        found = {}
        for label, contacts in (("copied", False), ("ours", True)):
            key = id(driving.clip), contacts
            if key not in moved:
                moved[key] = animate(mesh, driving.clip, motion=MotionOptions(ground=False, contacts=contacts)).clip
            found[label] = [np.asarray(moved[key].vertices[t], float) for t in driving.frames]
            posed = [mine.posed(vertices) for vertices in found[label]]
            row[f"contact {label}"] = driving.contact([of.distances(side) for of in posed for side in SIDES])
            row[f"penetration {label}"] = float(np.mean([of.penetration() for of in posed]))
        row["moved"] = not np.array_equal(found["copied"], found["ours"])
        rows.append(row)
    return rows


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Average the figures of each split and group of girths, and of each everyday contact on held-out characters."""
    corrected = {row["identity"] for row in rows if row["moved"]}

    def means(some: list[dict[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {"characters": len({row["identity"] for row in some}), "pairs": len(some)}
        for metric in ("contact", "penetration"):
            keys = [f"{metric} {label}" for label in ("driving", "copied", "ours")]
            known = [[row[key] for key in keys] for row in some if None not in (row[key] for key in keys)]
            if known:
                theirs, copied, ours = np.mean(known, axis=0)
                found |= {key: round(float(v), 4) for key, v in zip(keys, (theirs, copied, ours), strict=True)}
                if copied > theirs:
                    found[f"{metric} left"] = round(float((ours - theirs) / (copied - theirs)), 2)
        return found

    def group(row: dict[str, Any]) -> str:
        if row["identity"] not in corrected:
            return "without wrists"
        return next(name for name, (low, high) in GIRTHS.items() if low <= row["girth"] < high)

    table: dict[str, Any] = {}
    for split in ("train", "val"):
        for label, everyday in (("everyday", True), ("clips", False)):
            some = [row for row in rows if row["split"] == split and row["everyday"] is everyday]
            groups = {name: [row for row in some if group(row) == name] for name in (*GIRTHS, "without wrists")}
            table[f"{split} {label}"] = {name: means(of) for name, of in groups.items() if of}
    held = [row for row in rows if row["split"] == "val" and row["identity"] in corrected]
    table["val contacts"] = {name: means([row for row in held if row["driving"] == name]) for name in EVERYDAY}
    return table


if __name__ == "__main__":
    main()
