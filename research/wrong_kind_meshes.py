"""Things of boxes, rods and turned profiles that are neither people nor animals, for `measure_wrong_kind.py`."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mimesh.core.mesh import Mesh

Point = tuple[float, float, float]


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


def joined(name: str, pieces: list[Piece]) -> Mesh:
    """Make one mesh of pieces, which may intersect."""
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])])
    faces = [piece.faces + start for piece, start in zip(pieces, starts, strict=True)]
    return Mesh(np.concatenate([piece.vertices for piece in pieces]), np.concatenate(faces), name=name)
