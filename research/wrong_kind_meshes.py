"""Things of boxes, rods and turned profiles that are neither people nor animals, for `measure_wrong_kind.py`."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Float, Int
from trimesh import creation

from mimesh.core.mesh import Mesh

Point = tuple[float, float, float]
TABLES = (
    (1, 1, 0.45, 0.08), (2, 0.9, 0.75, 0.06), (0.5, 0.5, 0.6, 0.05), (1.2, 0.6, 0.4, 0.12), (0.8, 0.3, 1, 0.05),
    (1.5, 0.35, 0.8, 0.15),
)  # fmt: skip
"""Width, depth and height of tables, and the thickness of their legs."""


class Piece(NamedTuple):
    """A closed surface."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


def lofted(rings: Float[np.ndarray, "R N 3"]) -> Piece:
    """Join rings of points, one to the next, and close both ends."""
    rows, count = rings.shape[:2]
    quads = [(r * count + k, r * count + (k + 1) % count) for r in range(rows - 1) for k in range(count)]
    faces = [face for a, b in quads for face in ((a, b + count, b), (a, a + count, b + count))]
    low, high, last = rows * count, rows * count + 1, (rows - 1) * count
    for k in range(count):
        faces += [(k, (k + 1) % count, low), (last + (k + 1) % count, last + k, high)]
    return Piece(np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)]), np.array(faces))


def rod(start: Point, end: Point, radius: float, end_radius: float | None = None) -> Piece:
    """Make a round rod, thicker or thinner at its end."""
    first, last = np.array(start), np.array(end)
    along = (last - first) / np.linalg.norm(last - first)
    across = np.cross(along, [1.0, 0, 0] if abs(along[0]) < 0.9 else [0, 0, 1.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None]
    ring = np.cos(angle) * across + np.sin(angle) * np.cross(along, across)
    share = np.linspace(0, 1, 6)[:, None, None]
    radii = radius + ((radius if end_radius is None else end_radius) - radius) * share
    return lofted(first + (last - first) * share + radii * ring)


def turned(*profile: tuple[float, float]) -> Piece:
    """Turn a profile of heights and radii about the vertical."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    return lofted(np.stack([radius * circle + [0, height, 0] for height, radius in profile]))


def box(middle: Point, size: Point) -> Piece:
    """Make a box."""
    x, y, z = np.array(size) / 2
    ring = np.array([(-x, 0, -z), (x, 0, -z), (x, 0, z), (-x, 0, z)])
    return lofted(np.stack([ring + [0, h, 0] for h in np.linspace(-y, y, 4)]) + np.array(middle))


def ball(middle: Point, radii: Point) -> Piece:
    """Make an ellipsoid."""
    polar = np.linspace(0.05, np.pi - 0.05, 16)
    piece = turned(*((-np.cos(a), np.sin(a)) for a in polar))
    return Piece(piece.vertices * radii + np.array(middle), piece.faces)


def legs(x: float, z: float, height: float, width: float) -> list[Piece]:
    """Make the four legs of a piece of furniture."""
    return [box((i * x, height / 2, j * z), (width, height, width)) for i in (-1, 1) for j in (-1, 1)]


def path(points: list[Point], radius: float) -> list[Piece]:
    """Make rods from each point to the next."""
    return [rod(a, b, radius) for a, b in pairwise(points)]


def spider() -> list[Piece]:
    """Make a body of two balls with eight bent legs."""
    pieces = [ball((0, 0.5, 0), (0.3, 0.22, 0.35)), ball((0, 0.5, 0.45), (0.16, 0.16, 0.16))]
    for z in (0.3, 0.1, -0.1, -0.3):
        for s in (-1, 1):
            pieces += path([(s * 0.2, 0.5, z), (s * 0.6, 0.85, 1.6 * z), (s * 1.0, 0.0, 2.4 * z)], 0.035)
    return pieces


def around(count: int, radius: float, height: float) -> list[Point]:
    """List points on a horizontal circle."""
    return [
        (radius * np.cos(a), height, radius * np.sin(a))
        for a in np.linspace(0.5, 0.5 + 2 * np.pi, count, endpoint=False)
    ]


def things() -> list[Mesh]:
    """Make all things, y up."""
    trunk = rod((0, 0, 0), (0, 1.1, 0), 0.1, 0.06)
    arms = [path([(0.2 * x, 0.7, 0.2 * z), (0.6 * x, 0.3, 0.6 * z), (1.1 * x, 0.05, 1.1 * z)], 0.06)
            for x, _, z in around(8, 1.0, 0)]  # fmt: skip
    pieces = {
        "chair": [box((0, 0.5, 0), (0.5, 0.06, 0.5)), box((0, 0.85, -0.22), (0.5, 0.7, 0.06)),
                  *legs(0.2, 0.2, 0.5, 0.06)],
        "table": [box((0, 0.75, 0), (1.6, 0.05, 0.8)), *legs(0.7, 0.35, 0.75, 0.07)],
        "bed": [box((0, 0.4, 0), (1, 0.25, 2)), box((0, 0.7, -1), (1, 0.8, 0.06)), *legs(0.45, 0.9, 0.3, 0.08)],
        "sofa": [box((0, 0.3, 0), (2, 0.4, 0.9)), box((0, 0.7, -0.4), (2, 0.6, 0.2)),
                 *(box((x, 0.55, 0), (0.2, 0.4, 0.9)) for x in (-0.95, 0.95))],
        "stool": [turned((0.6, 0.2), (0.66, 0.2)), *(rod((0.5 * x, 0.6, 0.5 * z), (x, 0, z), 0.025)
                                                      for x, _, z in around(3, 0.28, 0))],
        "sword": [rod((0, 0, 0), (0, 0.25, 0), 0.02), box((0, 0.27, 0), (0.25, 0.03, 0.05)),
                  box((0, 0.75, 0), (0.05, 0.95, 0.01))],
        "axe": [rod((0, 0, 0), (0, 0.9, 0), 0.025), box((0.12, 0.8, 0), (0.22, 0.25, 0.03))],
        "tree": [rod((0, 0, 0), (0, 1.6, 0), 0.15, 0.1), ball((0, 2.1, 0), (0.8, 0.9, 0.8))],
        "bare tree": [trunk, *(rod((0, 1, 0), point, 0.06, 0.02) for point in around(9, 0.6, 1.5))],
        "fir": [rod((0, 0, 0), (0, 0.5, 0), 0.1), turned((0.4, 0.8), (1.1, 0.3)), turned((0.9, 0.6), (1.6, 0.2)),
                turned((1.4, 0.4), (2.1, 0.02))],
        "ball": [ball((0, 0, 0), (1, 1, 1))],
        "box": [box((0, 0.5, 0), (1, 1, 1))],
        "plank": [box((0, 0.02, 0), (0.3, 0.04, 2))],
        "bottle": [turned((0, 0.1), (0.05, 0.12), (0.5, 0.12), (0.65, 0.04), (0.8, 0.04), (0.82, 0.05))],
        "vase": [turned((0, 0.15), (0.1, 0.2), (0.3, 0.35), (0.6, 0.2), (0.7, 0.12), (0.8, 0.2))],
        "lamp": [turned((0, 0.2), (0.04, 0.2)), rod((0, 0, 0), (0, 1.4, 0), 0.02), turned((1.3, 0.3), (1.7, 0.15))],
        "car": [box((0, 0.5, 0), (1.6, 0.5, 4)), box((0, 0.95, -0.2), (1.4, 0.5, 2)),
                *(rod((i * 0.65, 0.3, z), (i * 0.9, 0.3, z), 0.3) for i in (-1, 1) for z in (-1.2, 1.2))],
        "house": [box((0, 1, 0), (3, 2, 4)), box((0, 2.4, 0), (2, 0.8, 4)), box((1, 3, 1), (0.3, 1, 0.3))],
        "aeroplane": [rod((0, 1, -2), (0, 1, 2), 0.25, 0.2), box((0, 1, 0.2), (4, 0.06, 0.7)),
                      box((0, 1.05, -1.8), (1.4, 0.05, 0.4)), box((0, 1.4, -1.8), (0.05, 0.7, 0.4))],
        "dumbbell": [rod((-0.3, 0, 0), (0.3, 0, 0), 0.03),
                     *(ball((x, 0, 0), (0.12, 0.12, 0.12)) for x in (-0.35, 0.35))],
        "snowman": [ball((0, y, 0), (r, r, r)) for y, r in ((0.5, 0.5), (1.25, 0.36), (1.8, 0.25))],
        "mug": [turned((0, 0.3), (0.8, 0.3)),
                *path([(0.3, 0.6, 0), (0.5, 0.55, 0), (0.5, 0.25, 0), (0.3, 0.2, 0)], 0.04)],
        "ladder": [rod((-0.2, 0, 0), (-0.2, 2, 0), 0.03), rod((0.2, 0, 0), (0.2, 2, 0), 0.03),
                   *(rod((-0.2, y, 0), (0.2, y, 0), 0.02) for y in np.arange(0.2, 2, 0.3).tolist())],
        "cross": [box((0, 1, 0), (0.2, 2, 0.1)), box((0, 1.4, 0), (1.2, 0.2, 0.1))],
        "tripod": [ball((0, 1.4, 0), (0.12, 0.12, 0.12)),
                   *(rod((0, 1.3, 0), point, 0.03) for point in around(3, 0.5, 0))],
        "spider": spider(),
        "fish": [ball((0, 0.5, 0), (0.12, 0.25, 0.6)), rod((0, 0.7, 0.1), (0, 0.95, -0.1), 0.06, 0.02),
                 *(rod((0, 0.5, -0.55), (0, y, -0.9), 0.08, 0.02) for y in (0.2, 0.8))],
        "bird": [ball((0, 1, 0), (0.18, 0.18, 0.4)), ball((0, 1.12, 0.42), (0.12, 0.12, 0.12)),
                 *(rod((s * 0.1, 1, 0), (s * 1.2, 1.1, -0.1), 0.12, 0.03) for s in (-1, 1)),
                 rod((0, 1, -0.3), (0, 1, -0.7), 0.08, 0.1)],
        "snake": path([(0.3 * np.sin(t), 0.08, 0.25 * t) for t in np.linspace(0, 8, 24)], 0.07),
        "octopus": [ball((0, 1, 0), (0.35, 0.45, 0.35)), *(piece for arm in arms for piece in arm)],
    }  # fmt: skip
    return [joined(name, parts) for name, parts in pieces.items()]


def branches(seed: int, levels: int, up: float, spread: float) -> list[Piece]:
    """Make the trunk of a tree with branches that branch again, without leaves."""
    rng = np.random.default_rng(seed)

    def grown(start: np.ndarray, along: np.ndarray, length: float, radius: float, level: int) -> list[Piece]:
        pieces = [rod(tuple(start), tuple(start + length * along), radius, 0.7 * radius)]
        for _ in range(int(rng.integers(3, 5)) if level else 0):
            share, turn = rng.uniform(0.5, 1), along + spread * rng.normal(size=3) + [0, up, 0]
            begin = start + length * share * along
            turn, shorter = turn / np.linalg.norm(turn), length * rng.uniform(0.5, 0.75)
            pieces += grown(begin, turn, shorter, 0.55 * radius, level - 1)
        return pieces

    return grown(np.zeros(3), np.array([0.0, 1, 0]), 1.0, 0.1, levels)


def leaves(seed: int, tree: list[Piece]) -> list[Piece]:
    """Make 250 squares about the ends of branches."""
    rng, ends, pieces = np.random.default_rng(seed), np.array([piece.vertices[-1] for piece in tree]), []
    for _ in range(250):
        corner = ends[int(rng.integers(len(ends)))] + 0.2 * rng.normal(size=3)
        side, other = 0.1 * (turn := rng.normal(size=(2, 3))) / np.linalg.norm(turn, axis=1)[:, None]
        square = np.array([corner, corner + side, corner + side + other, corner + other])
        pieces.append(Piece(square, np.array([[0, 1, 2], [0, 2, 3]])))
    return pieces


def terrain(seed: int, height: float, waves: float) -> list[Piece]:
    """Make a square sheet with hills; flat without a height."""
    x, z = np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 40), indexing="ij")
    directions = enumerate(np.random.default_rng(seed).uniform(0, 6.28, (5, 2)), 1)
    y = sum(height / k * np.sin(waves * k * (x * np.cos(a) + z * np.sin(a)) / 2 + b) for k, (a, b) in directions)
    i = (np.arange(39)[:, None] * 40 + np.arange(39)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 41], 1), np.stack([i, i + 41, i + 40], 1)])
    return [Piece(np.stack([x, 0.3 * y, z], -1).reshape(-1, 3), faces)]


def hand(spread: float, bend: float) -> list[Piece]:
    """Make a palm with a wrist, four fingers and a thumb, fingers up."""
    pieces = [box((0, 0.1, 0), (0.09, 0.1, 0.03)), rod((0, -0.03, 0), (0, 0.06, 0), 0.03)]
    for i, x in enumerate((-0.033, -0.011, 0.011, 0.033)):
        off = spread * (i - 1.5)
        pieces += path([(x, 0.15, 0), (x + 0.012 * off, 0.19, 0.01 * bend), (x + 0.02 * off, 0.23, 0.03 * bend)], 0.009)
    return pieces + path([(0.045, 0.08, 0), (0.075, 0.12, 0.01), (0.085, 0.15, 0.015)], 0.011)


def table(width: float, depth: float, height: float, leg: float) -> list[Piece]:
    """Make a table with four legs."""
    return [box((0, height, 0), (width, 0.06, depth)), *legs(width / 2 - leg, depth / 2 - leg, height, leg)]


def car(length: float, width: float, height: float) -> list[Piece]:
    """Make a car of two boxes and four wheels."""
    wheels = [wheel(i * width * 0.45, 0.3, j * length * 0.32, 0.32, 0.2) for i in (-1, 1) for j in (-1, 1)]
    low, high = (width, height * 0.4, length), (width * 0.85, height * 0.45, length * 0.5)
    return [box((0, height * 0.35, 0), low), box((0, height * 0.75, -0.2), high), *wheels]


def wheel(x: float, y: float, z: float, radius: float, width: float, axis: int = 0) -> Piece:
    """Make a disc about an axis."""
    half = np.eye(3)[axis] * width / 2
    return rod(tuple(np.array([x, y, z]) - half), tuple(np.array([x, y, z]) + half), radius)


def of_trimesh(mesh: trimesh.Trimesh) -> Piece:
    """Take a shape of trimesh."""
    return Piece(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def further_things() -> list[Mesh]:
    """Make more furniture, plants, vehicles, weapons, animals without four legs, letters and plain solids, y up."""
    upright, across = (trimesh.transformations.rotation_matrix(angle, axis)
                       for angle, axis in ((-np.pi / 2, [1, 0, 0]), (np.pi / 2, [0, 1, 0])))  # fmt: skip
    bicycle_wheels = [trimesh.transformations.translation_matrix((0, 0.34, z)) @ across for z in (-0.5, 0.5)]
    horse = [rod((0, 1, -0.7), (0, 1, 0.7), 0.2), *(rod((i * 0.15, 0.95, j * 0.5), (i * 0.3, 0, j * 0.6), 0.05)
                                                    for i in (-1, 1) for j in (-1, 1))]  # fmt: skip
    pieces = {
        "oak": branches(9, 1, 0.1, 0.8) + [ball((x, 1.4 + 0.2 * y, z), (0.5, 0.4, 0.5))
          for x, y, z in np.random.default_rng(2).normal(size=(7, 3)) * 0.5],
        "palm": [rod((0, 0, 0), (0.15, 2, 0), 0.12, 0.08)] + [p for x, _, z in around(9, 1, 0)
          for p in path([(0.15, 2, 0), (0.15 + 0.5 * x, 2.2, 0.5 * z), (0.15 + x, 1.8, z)], 0.05)],
        "bush": [ball(tuple(c), (0.3, 0.3, 0.3)) for c in np.random.default_rng(3).normal(size=(12, 3)) * 0.35],
        "y tree": [rod((0, 0, 0), (0, 1, 0), 0.12, 0.1), rod((0, 1, 0), (-0.6, 1.8, 0), 0.09, 0.03), rod((0, 1, 0),
          (0.6, 1.8, 0), 0.09, 0.03)],
        "tree with roots": [rod((0, 0.3, 0), (0, 1.3, 0), 0.15, 0.12), rod((0, 1.2, 0), (-0.7, 1.9, 0), 0.1, 0.03),
          rod((0, 1.2, 0), (0.7, 1.9, 0.1), 0.1, 0.03), rod((0, 0.4, 0), (-0.4, 0, 0), 0.1, 0.04), rod((0, 0.4, 0),
          (0.4, 0, 0.1), 0.1, 0.04), ball((0, 1.6, 0), (0.2, 0.25, 0.2))],
        "cactus": [rod((0, 0, 0), (0, 1.6, 0), 0.18, 0.16), *path([(0, 0.7, 0), (0.5, 0.7, 0), (0.5, 1.2, 0)], 0.1),
          *path([(0, 0.9, 0), (-0.45, 0.9, 0), (-0.45, 1.4, 0)], 0.1), ball((0, 1.6, 0), (0.16, 0.16, 0.16))],
        "round table": [turned((0.72, 0.6), (0.76, 0.6)), rod((0, 0, 0), (0, 0.72, 0), 0.06), turned((0, 0.3),
          (0.04, 0.28))],
        "table with thick top and thin long legs": [box((0, 0.9, 0), (0.5, 0.25, 1.2)), *legs(0.2, 0.5, 0.8, 0.08)],
        "table with drawers": [box((0, 0.75, 0), (1.4, 0.05, 0.7)), box((0.45, 0.55, 0), (0.4, 0.35, 0.6)),
          *legs(0.65, 0.3, 0.75, 0.06)],
        "pommel horse": horse,
        "rocking horse": [rod((0, 0.6, -0.35), (0, 0.6, 0.35), 0.15), rod((0, 0.7, 0.3), (0, 1, 0.5), 0.09),
          rod((0, 1, 0.45), (0, 0.9, 0.7), 0.08, 0.05), *(rod((i * 0.1, 0.55, j * 0.3), (i * 0.15, 0.1, j * 0.4),
          0.05) for i in (-1, 1) for j in (-1, 1)), *(p for i in (-1, 1) for p in path([(i * 0.15, 0.15, -0.7),
          (i * 0.15, 0.05, -0.3), (i * 0.15, 0.05, 0.3), (i * 0.15, 0.15, 0.7)], 0.03))],
        "chair with arms": [box((0, 0.45, 0), (0.55, 0.06, 0.5)), box((0, 0.8, -0.23), (0.55, 0.7, 0.05)),
          *legs(0.24, 0.22, 0.45, 0.05), *(box((i * 0.26, 0.65, 0), (0.05, 0.04, 0.45)) for i in (-1, 1)),
          *(box((i * 0.26, 0.55, 0.2), (0.04, 0.2, 0.04)) for i in (-1, 1))],
        "chair slats": [box((0, 0.45, 0), (0.45, 0.04, 0.45)), *legs(0.2, 0.2, 0.45, 0.04),
          *(rod((i * 0.2, 0.45, -0.2), (i * 0.2, 1.0, -0.25), 0.02) for i in (-1, 1)), *(box((0, y, -0.23),
          (0.4, 0.06, 0.02)) for y in (0.65, 0.8, 0.95))],
        "office chair": [box((0, 0.5, 0), (0.5, 0.1, 0.5)), box((0, 0.9, -0.25), (0.45, 0.6, 0.08)), rod((0, 0.1, 0),
          (0, 0.5, 0), 0.04), *(rod((0, 0.1, 0), (x, 0.05, z), 0.03) for x, _, z in around(5, 0.35, 0))],
        "high back chair": [box((0, 0.5, 0), (0.5, 0.08, 0.5)), box((0, 1.1, -0.22), (0.5, 1.2, 0.06)),
          *legs(0.2, 0.2, 0.5, 0.06)],
        "stool 4": [turned((0.6, 0.2), (0.65, 0.2)), *(rod((0.4 * x, 0.6, 0.4 * z), (x, 0, z), 0.03)
          for x, _, z in around(4, 0.25, 0))],
        "bar stool": [turned((0.8, 0.2), (0.87, 0.2)), rod((0, 0, 0), (0, 0.8, 0), 0.03), turned((0, 0.25),
          (0.03, 0.25))],
        "bench": [box((0, 0.45, 0), (1.5, 0.06, 0.4)), *legs(0.65, 0.15, 0.45, 0.08), box((0, 0.75, -0.2),
          (1.5, 0.3, 0.04))],
        "park bench sides": [box((0, 0.45, z), (1.8, 0.04, 0.1)) for z in (-0.2, -0.05, 0.1)] + [box((x, 0.22, -0.05),
          (0.06, 0.45, 0.45)) for x in (-0.8, 0.8)] + [box((0, y, -0.3), (1.8, 0.1, 0.04)) for y in (0.65, 0.85)],
        "tripod tall": [ball((0, 1.5, 0), (0.1, 0.08, 0.15)), rod((0, 1.2, 0), (0, 1.5, 0), 0.03), *(rod((0, 1.25, 0),
          p, 0.025) for p in around(3, 0.45, 0))],
        "floor lamp": [turned((0, 0.18), (0.03, 0.18)), rod((0, 0, 0), (0, 1.5, 0), 0.015), turned((1.4, 0.25),
          (1.75, 0.12))],
        "desk lamp": [turned((0, 0.12), (0.03, 0.12)), *path([(0, 0, 0), (0, 0.35, -0.15), (0, 0.6, 0.15)], 0.015),
          turned((0.5, 0.12), (0.65, 0.03))],
        "street lamp": [rod((0, 0, 0), (0, 4, 0), 0.08, 0.05), rod((0, 4, 0), (0, 4.2, 1), 0.05), box((0, 4.15, 1.1),
          (0.2, 0.1, 0.5))],
        "bicycle": [*(of_trimesh(creation.torus(0.34, 0.03, transform=place)) for place in bicycle_wheels),
          *path([(0, 0.34, -0.5), (0, 0.8, -0.2), (0, 0.75, 0.35), (0, 0.34, 0.5)], 0.02),
          *path([(0, 0.8, -0.2), (0, 0.3, 0), (0, 0.75, 0.35), (0, 1.0, 0.3)], 0.02),
          rod((-0.25, 1.0, 0.3), (0.25, 1.0, 0.3), 0.02), box((0, 0.88, -0.22), (0.12, 0.05, 0.25))],
        "motorbike": [wheel(0, 0.3, z, 0.3, 0.15) for z in (-0.6, 0.6)] + [box((0, 0.55, 0), (0.3, 0.4, 0.7)),
          rod((0, 0.3, 0.6), (0, 1, 0.35), 0.05), rod((-0.35, 1, 0.35), (0.35, 1, 0.35), 0.025), box((0, 0.8, -0.3),
          (0.25, 0.1, 0.6))],
        "truck": [box((0, 1.6, -1), (2.2, 2.4, 4)), box((0, 1.2, 2), (2.1, 1.7, 1.5)), *(wheel(i, 0.45, z, 0.45, 0.3)
          for i in (-1, 1) for z in (-2.4, -1.3, 2))],
        "tank": [box((0, 0.8, 0), (2.5, 0.8, 5)), box((0, 1.5, 0), (1.6, 0.6, 2)), rod((0, 1.5, 1), (0, 1.6, 4.5),
          0.1), *(box((i * 1.3, 0.4, 0), (0.5, 0.8, 5.4)) for i in (-1, 1))],
        "ship": [lofted(np.stack([np.array([(-w, 1, z), (w, 1, z), (w * 0.4, 0, z), (-w * 0.4, 0, z)])
          for z, w in ((-3, 0.5), (-1, 0.9), (1, 0.9), (2.5, 0.5), (3.2, 0.05))])), box((0, 1.3, -1), (1, 0.6, 1.5)),
          rod((0, 1, 0.5), (0, 4, 0.5), 0.06), rod((-1, 3, 0.5), (1, 3, 0.5), 0.04)],
        "plane jet": [rod((0, 1, -3), (0, 1, 2), 0.4, 0.35), ball((0, 1, 2.2), (0.35, 0.35, 1)),
          *(lofted(np.stack([np.array([(s * x, 1 - 0.03, z - c), (s * x, 1 + 0.03, z - c), (s * x, 1 + 0.03, z + c),
          (s * x, 1 - 0.03, z + c)]) for x, z, c in ((0.3, 0, 0.8), (3, -1.2, 0.3))])) for s in (-1, 1)),
          *(box((s * 0.7, 1.1, -2.8), (1.2, 0.05, 0.5)) for s in (-1, 1)), box((0, 1.7, -2.8), (0.06, 1.1, 0.6))],
        "helicopter": [ball((0, 1.2, 0.3), (0.6, 0.6, 1.0)), rod((0, 1.3, -0.5), (0, 1.4, -3), 0.2, 0.08),
          box((0, 2, 0.2), (5, 0.03, 0.2)), box((0, 2, 0.2), (0.2, 0.03, 5)), rod((0, 1.6, 0.2), (0, 2, 0.2), 0.06),
          *(rod((s * 0.6, 0.2, -1), (s * 0.6, 0.2, 1.3), 0.05) for s in (-1, 1)), *(rod((s * 0.3, 0.9, z),
          (s * 0.6, 0.2, z), 0.04) for s in (-1, 1) for z in (-0.4, 0.8))],
        "rifle": [rod((0, 0, 0), (0, 0, 1), 0.02), box((0, 0, -0.1), (0.05, 0.1, 0.4)), box((0, -0.07, -0.5),
          (0.04, 0.16, 0.4)), box((0, -0.15, -0.05), (0.03, 0.2, 0.07)), box((0, -0.12, -0.25), (0.03, 0.15, 0.04)),
          rod((0, 0.08, -0.15), (0, 0.08, 0.1), 0.02)],
        "pistol": [box((0, 0, 0), (0.03, 0.04, 0.2)), box((0, -0.07, -0.07), (0.03, 0.12, 0.05))],
        "sword curved": path([(0, 0.2 * np.sin(t), t) for t in np.linspace(0, 1.2, 9)], 0.02) + [box((0, 0.0, 0.0),
          (0.15, 0.03, 0.03))],
        "hammer": [rod((0, 0, 0), (0, 0.8, 0), 0.03), box((0, 0.8, 0), (0.35, 0.15, 0.15))],
        "bow": path([(0, y, 0.3 * (1 - y * y)) for y in np.linspace(-1, 1, 13)], 0.02) + [rod((0, -1, 0), (0, 1, 0),
          0.005)],
        "shield": [of_trimesh(creation.icosphere(3, 1).apply_scale((0.5, 0.7, 0.12)))],
        "starfish": [rod((0, 0, 0), p, 0.2, 0.05) for p in around(5, 1, 0)],
        "starfish standing": [rod((0, 1, 0), (np.sin(a), 1 + np.cos(a), 0), 0.22, 0.05)
          for a in np.arange(5) * 2 * np.pi / 5],
        "star": [box((0, 0, 0), (0.5, 0.5, 0.2))] + [rod((0, 0, 0), (np.sin(a), np.cos(a), 0), 0.2, 0.01)
          for a in np.arange(5) * 2 * np.pi / 5],
        "jellyfish": [ball((0, 1.2, 0), (0.5, 0.35, 0.5))] + [p for x, _, z in around(7, 0.35, 0)
          for p in path([(x, 1.1, z), (1.1 * x, 0.6, 0.9 * z), (0.9 * x, 0.1, 1.1 * z)], 0.03)],
        "crab": [ball((0, 0.3, 0), (0.5, 0.15, 0.35))] + [p for s in (-1, 1) for z in (-0.25, -0.1, 0.05, 0.2)
          for p in path([(s * 0.4, 0.3, z), (s * 0.8, 0.45, 1.4 * z), (s * 1.0, 0, 1.6 * z)], 0.035)] + [p
          for s in (-1, 1) for p in path([(s * 0.4, 0.3, 0.25), (s * 0.7, 0.35, 0.6), (s * 0.4, 0.35, 0.9)], 0.07)],
        "ant": [ball((0, 0.3, z), (0.12, 0.12, r)) for z, r in ((-0.5, 0.3), (0, 0.2), (0.4, 0.15))] + [p
          for s in (-1, 1) for z in (-0.15, 0, 0.15) for p in path([(s * 0.1, 0.3, z), (s * 0.35, 0.45, 2 * z),
          (s * 0.55, 0, 3 * z)], 0.02)],
        "snake coiled": path([((0.4 + 0.02 * t) * np.cos(t), 0.06 + 0.03 * t, (0.4 + 0.02 * t) * np.sin(t))
          for t in np.linspace(0, 14, 50)], 0.06),
        "snake up": path([(0, 1.0, 0), (0, 0.7, 0.1), (0, 0.4, -0.05), (0, 0.1, -0.1), (0.3, 0.06, -0.3),
          (-0.3, 0.06, -0.6), (0.3, 0.06, -0.9)], 0.06),
        "worm straight": [rod((0, 0.1, -1), (0, 0.1, 1), 0.1)],
        "bird standing": [ball((0, 0.5, 0), (0.16, 0.16, 0.3)), ball((0, 0.75, 0.28), (0.1, 0.1, 0.1)),
          rod((0, 0.6, 0.15), (0, 0.75, 0.25), 0.07), rod((0, 0.74, 0.36), (0, 0.72, 0.5), 0.03, 0.005),
          rod((0, 0.5, -0.2), (0, 0.45, -0.6), 0.07, 0.1), *(rod((s * 0.07, 0.4, 0), (s * 0.07, 0, 0.02), 0.02)
          for s in (-1, 1)), *(box((s * 0.07, 0.01, 0.06), (0.08, 0.02, 0.16)) for s in (-1, 1)),
          *(ball((s * 0.16, 0.52, -0.05), (0.03, 0.12, 0.25)) for s in (-1, 1))],
        "bird flying": [ball((0, 1, 0), (0.12, 0.12, 0.35)), ball((0, 1.05, 0.38), (0.09, 0.09, 0.09)),
          rod((0, 1, -0.3), (0, 1, -0.6), 0.06, 0.12)] + [q for s in (-1, 1) for q in path([(s * 0.1, 1, 0.05),
          (s * 0.6, 1.25, 0.1), (s * 1.2, 1.1, -0.15)], 0.05)],
        "whale": [ball((0, 0.5, 0), (0.4, 0.4, 1.2)), *(rod((s * 0.3, 0.4, 0.4), (s * 0.9, 0.2, 0.2), 0.12, 0.04)
          for s in (-1, 1)), *(rod((0, 0.5, -1.1), (s * 0.5, 0.55, -1.6), 0.12, 0.04) for s in (-1, 1))],
        "turtle shell": [ball((0, 0.2, 0), (0.4, 0.2, 0.5))],
        "bottle tall": [turned((0, 0.1), (0.6, 0.1), (0.75, 0.03), (0.9, 0.03))],
        "cup": [turned((0, 0.2), (0.5, 0.3), (0.52, 0.3))],
        "torus": [of_trimesh(creation.torus(1, 0.3))],
        "torus thin": [of_trimesh(creation.torus(1, 0.05))],
        "sphere": [of_trimesh(creation.icosphere(4))],
        "capsule": [of_trimesh(creation.capsule(1.2, 0.3).apply_transform(upright))],
        "cylinder": [of_trimesh(creation.cylinder(0.3, 1.5).apply_transform(upright))],
        "cone": [of_trimesh(creation.cone(0.5, 1.5).apply_transform(upright))],
        "castle": [box((0, 0.6, 0), (2, 1.2, 2)), *(rod((i, 0, j), (i, 1.8, j), 0.3) for i in (-1, 1)
          for j in (-1, 1))],
        "tower": [rod((0, 0, 0), (0, 3, 0), 0.6, 0.5), turned((3, 0.7), (4, 0.01))],
        "church": [box((0, 0.8, 0), (1.5, 1.6, 3)), box((0, 1.6, 1.6), (0.8, 3.2, 0.8)), box((0, 3.6, 1.6),
          (0.1, 0.8, 0.1)), box((0, 3.7, 1.6), (0.5, 0.1, 0.1))],
        "windmill": [rod((0, 0, 0), (0, 2, 0), 0.6, 0.35), *(box((0.9 * np.cos(a), 1.8 + 0.9 * np.sin(a), 0.5),
          (0.2 + 1.4 * abs(np.cos(a)), 0.2 + 1.4 * abs(np.sin(a)), 0.04)) for a in np.arange(4) * np.pi / 2)],
        "scarecrow cross": [rod((0, 0, 0), (0, 1.7, 0), 0.04), rod((-0.7, 1.3, 0), (0.7, 1.3, 0), 0.04),
          ball((0, 1.75, 0), (0.14, 0.16, 0.14))],
        "signpost": [rod((0, 0, 0), (0, 2, 0), 0.05), box((0.3, 1.7, 0), (0.7, 0.25, 0.04)), box((-0.25, 1.35, 0),
          (0.6, 0.25, 0.04))],
        "coat rack": [rod((0, 0, 0), (0, 1.7, 0), 0.025), *(rod((0, 1.6, 0), p, 0.02) for p in around(4, 0.25, 1.75)),
          *(rod((0, 0.1, 0), p, 0.02) for p in around(4, 0.3, 0))],
        "cloth hanger": path([(-0.4, 0, 0), (0, 0.2, 0), (0.4, 0, 0), (-0.4, 0, 0)], 0.015) + path([(0, 0.2, 0),
          (0, 0.3, 0), (0.05, 0.35, 0)], 0.012),
        "umbrella": [turned((0.9, 0.7), (1.1, 0.4), (1.2, 0.02)), rod((0, 0, 0), (0, 1.2, 0), 0.02)],
        "mushroom": [turned((0, 0.15), (0.6, 0.12)), ball((0, 0.7, 0), (0.5, 0.25, 0.5))],
        "guitar": [ball((0, 0.25, 0), (0.25, 0.25, 0.06)), ball((0, 0.55, 0), (0.18, 0.18, 0.06)), box((0, 0.95, 0),
          (0.06, 0.7, 0.03)), box((0, 1.35, 0), (0.1, 0.15, 0.03))],
        "scissors": path([(-0.1, 0, 0), (0.1, 1, 0)], 0.03) + path([(0.1, 0, 0), (-0.1, 1, 0)],
          0.03) + [of_trimesh(creation.torus(0.12, 0.03).apply_translation((s * 0.18, -0.08, 0))) for s in (-1, 1)],
        "pliers": path([(-0.25, 0, 0), (-0.05, 0.5, 0), (0.06, 0.8, 0)], 0.05) + path([(0.25, 0, 0), (0.05, 0.5, 0),
          (-0.06, 0.8, 0)], 0.05) + [ball((0, 0.5, 0), (0.1, 0.1, 0.06))],
        "candelabra": [turned((0, 0.25), (0.05, 0.2)), rod((0, 0, 0), (0, 1.2, 0), 0.04), *(q for s in (-1, 1)
          for q in path([(0, 0.7, 0), (s * 0.4, 0.75, 0), (s * 0.4, 1.1, 0)], 0.035))],
        "trident": [rod((0, 0, 0), (0, 1.6, 0), 0.03), *(q for s in (-1, 1) for q in path([(0, 1.2, 0),
          (s * 0.2, 1.25, 0), (s * 0.2, 1.6, 0)], 0.025))],
        "robot arm": [turned((0, 0.3), (0.2, 0.3)), *path([(0, 0.2, 0), (0, 0.9, -0.3), (0.2, 1.4, 0.3),
          (0.2, 1.0, 0.8)], 0.1), *(rod((0.2, 1.0, 0.8), (0.2 + s * 0.15, 0.8, 0.9), 0.03) for s in (-1, 1))],
        "drone": [box((0, 0.2, 0), (0.3, 0.1, 0.3))] + [q for x in (-1, 1) for z in (-1, 1) for q in (rod((0, 0.2, 0),
          (0.4 * x, 0.25, 0.4 * z), 0.03), wheel(0.4 * x, 0.28, 0.4 * z, 0.22, 0.02, 1))],
        "water tower": [ball((0, 2.5, 0), (0.8, 0.6, 0.8)), *(rod((0.4 * x, 2.2, 0.4 * z), (x, 0, z), 0.06)
          for x, _, z in around(4, 0.8, 0))],
        "robot dog of boxes without head": [box((0, 0.6, 0), (0.4, 0.25, 0.9)), *legs(0.15, 0.35, 0.5, 0.1)],
        "gate": [box((x, 1, 0), (0.3, 2, 0.3)) for x in (-1, 1)] + [box((0, 2.1, 0), (2.6, 0.3, 0.3))],
        "arch": path([(np.cos(a), 1.2 * np.sin(a), 0) for a in np.linspace(0, np.pi, 15)], 0.15),
        "letter A": path([(-0.5, 0, 0), (0, 1.5, 0), (0.5, 0, 0)], 0.1) + [rod((-0.25, 0.6, 0), (0.25, 0.6, 0),
          0.08)],
        "letter X": path([(-0.5, 0, 0), (0.5, 1.5, 0)], 0.12) + path([(0.5, 0, 0), (-0.5, 1.5, 0)], 0.12),
        "letter H": [box((x, 0.75, 0), (0.25, 1.5, 0.2)) for x in (-0.45, 0.45)] + [box((0, 0.75, 0),
          (0.8, 0.2, 0.2))],
        "letter T": [box((0, 0.75, 0), (0.25, 1.5, 0.2)), box((0, 1.4, 0), (1.2, 0.25, 0.2))],
        "bunch of boxes": [box(tuple(c), (0.3, 0.4, 0.3)) for c in np.random.default_rng(4).uniform(-1, 1, (10, 3))],
    }  # fmt: skip
    pieces["vaulting horse with neck"] = [*horse, rod((0, 1, 0.7), (0, 1.5, 1.0), 0.1, 0.08)]
    pieces |= {f"table {k}": table(*sizes) for k, sizes in enumerate(TABLES)}
    pieces |= {f"car {k}": car(*sizes) for k, sizes in enumerate(((4, 1.7, 1.4), (5, 2, 2.2), (3, 1.5, 1.5)))}
    pieces |= {f"terrain {k}": terrain(k, *hills) for k, hills in enumerate(((0, 6), (0.3, 6), (0.8, 4), (1.5, 9)))}
    pieces |= {"hand open": hand(1, 0), "hand bent": hand(0.5, 2)}
    for k in range(6):
        tree = branches(k, 2 + k % 2, (0.3, 0.1, 0.6)[k % 3], (0.8, 0.5, 1.1)[k % 3])
        pieces |= {f"tree with branches {k}": tree, f"tree with leaves {k}": tree + leaves(k, tree)}
    return [joined(name, parts) for name, parts in pieces.items()]


def joined(name: str, pieces: list[Piece]) -> Mesh:
    """Make one mesh of pieces, which may intersect."""
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])])
    faces = [piece.faces + start for piece, start in zip(pieces, starts, strict=True)]
    return Mesh(np.concatenate([piece.vertices for piece in pieces]), np.concatenate(faces), name=name)
