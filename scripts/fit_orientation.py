"""Train the shipped detector of up and front axes: python scripts/fit_orientation.py [--check MESH...]

A two-layer network scores the occupancy grid of a person in each of the 24 axis rotations; the loss is the 24-way
cross-entropy of the correct one. People, poses and headings are random variants of the shipped body. Takes ten minutes
on one core.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.sampling import JOINT_LIMITS, limits_rotvec, rotvec_to_rotmat, sample_pose
from mimesh.core import normalization
from mimesh.core.surface_points import sample_surface

HIDDEN = 64
"""Units of the hidden layer."""
POINTS = 1200
"""Points of a training person."""
UPRIGHT = next(r for r, names in enumerate(normalization.ORIENTATIONS) if names == ("+y", "+z"))
"""Index of the correct rotation: training people stand upright and face +z."""
TURNS = [r for r, (up, _) in enumerate(normalization.ORIENTATIONS) if up == "+y"]
"""The upright rotations. Front is harder to detect than up, so every training step uses all of these."""
OTHERS = [r for r in range(24) if r not in TURNS]
"""The other rotations, of which every step uses a random sample."""
KINDS = ("rest", "arms down", "table 6", "wide")
"""Kinds of poses."""


def surface_body(body: RiggedBody, rng: np.random.Generator, by_area: bool) -> RiggedBody:
    """Reduce the body to points: uniform by area (as the features of a mesh) or random vertices (of a point cloud)."""
    if not by_area:
        chosen = rng.choice(len(body.vertices), POINTS, replace=False)
        parts = body.vertices[chosen], body.components[:, chosen], body.weights[chosen]
    else:
        face, weight = sample_surface(body.vertices, body.faces, POINTS, rng)
        corner = body.faces[face]
        parts = (
            np.einsum("nk,nkc->nc", weight, body.vertices[corner]),
            np.einsum("nk,qnkc->qnc", weight, body.components[:, corner]),
            np.einsum("nk,nkj->nj", weight, body.weights[corner]),
        )
    return dataclasses.replace(body, vertices=parts[0], components=parts[1], weights=parts[2])


def draw_pose(body: RiggedBody, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Draw the rotation vectors (J, 3) of a pose of the given kind."""
    low, high = limits_rotvec(body, JOINT_LIMITS)
    noise = rng.uniform(low, high)
    if kind == "rest":
        return np.zeros_like(noise)
    if kind == "table 6":
        return sample_pose(body, int(rng.integers(2**31)), 0)
    if kind == "wide":
        return noise * rng.uniform(0.3, 1)
    pose = 0.15 * noise
    angle = np.radians(rng.uniform(20, 85))
    pose[body.joint("LeftArm"), 2], pose[body.joint("RightArm"), 2] = -angle, angle
    return pose


def scale_parts(
    body: RiggedBody, vertices: np.ndarray, joints: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Apply cartoon proportions to half of the people: large heads, hands and feet, short legs and arms."""
    if rng.random() < 0.5:
        return vertices, joints
    legs, arms = rng.uniform(0.4, 1.1), rng.uniform(0.6, 1.1)
    hip, shoulder = joints[body.joint("LeftUpLeg"), 1], joints[body.joint("LeftArm"), 0]
    vertices, joints = (shorten(points, hip, legs, shoulder, arms) for points in (vertices, joints))
    ranges = {"Head": (0.85, 2.8), "Hand": (0.7, 1.8), "Foot": (0.7, 1.8)}
    for part, (low, high) in ranges.items():
        factor = np.exp(rng.uniform(np.log(low), np.log(high)))
        for j in (j for j, name in enumerate(body.joint_names) if name.endswith(part)):
            vertices = vertices + body.weights[:, j, None] * (factor - 1) * (vertices - joints[j])
    return vertices, joints


def shorten(points: np.ndarray, hip: float, legs: float, shoulder: float, arms: float) -> np.ndarray:
    """Scale the parts below the hips and beyond the shoulders of a T-pose."""
    x, y, z = points.T
    beyond = np.maximum(np.abs(x) - shoulder, 0)
    return np.stack([x - np.sign(x) * beyond * (1 - arms), np.where(y < hip, hip + legs * (y - hip), y), z], axis=1)


def dress(body: RiggedBody, vertices: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Imitate cloth, hair and modelling styles: a smooth random warp, and for some people hair around the head."""
    size = 0.5 * np.ptp(vertices[:, 1])
    warp = np.zeros_like(vertices)
    for _ in range(4):
        wave, phase = rng.normal(size=3) * 4 / size, rng.uniform(0, 2 * np.pi)
        warp += np.sin(vertices @ wave + phase)[:, None] * rng.normal(size=3)
    vertices = vertices + warp * rng.uniform(0, 0.02) * size
    if rng.random() < 0.5:
        head = np.flatnonzero(body.weights[:, body.joint("Head")] > 0.5)
        chosen = rng.choice(head, int(rng.uniform(0.2, 0.8) * len(head)), replace=False)
        low, high = vertices[head].min(axis=0), vertices[head].max(axis=0)
        length, width, depth = rng.uniform(0.4, 2.0), rng.uniform(0.7, 1.4), rng.uniform(0.4, 0.8)
        unit = rng.normal(size=(len(chosen), 3))
        unit *= 0.5 / np.linalg.norm(unit, axis=1, keepdims=True)
        middle = (low + high) / 2 + [0, 0.55 - length / 2, -0.25] * (high - low)
        vertices[chosen] = middle + unit * [width, length, depth] * (high - low)
    return vertices


def draw_person(body: RiggedBody, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Draw the occupancy features of a random person, upright and within 40 degrees of facing +z."""
    vertices, joints = body.shaped(np.clip(rng.normal(size=len(body.components)), -2.5, 2.5) * rng.uniform(0, 1.4))
    vertices, joints = scale_parts(body, vertices, joints, rng)
    vertices = dress(body, vertices, rng)
    rotation, translation = body.skinning_transforms(joints, rotvec_to_rotmat(draw_pose(body, kind, rng)))
    points = np.einsum("vj,jkl,vl->vk", body.weights, rotation, vertices, optimize=True) + body.weights @ translation
    points = points * np.exp(rng.uniform(-0.15, 0.15, 3))
    if rng.random() < 0.3:  # an object carried or worn
        blob = rng.normal(size=(int(rng.integers(20, 200)), 3)) * rng.uniform(0.03, 0.15, 3)
        points[rng.choice(len(points), len(blob), replace=False)] = points[rng.integers(len(points))] + blob
    points = points + rng.normal(size=points.shape) * rng.uniform(0, 0.015)
    heading = rng.uniform(-40, 40) if rng.random() < 0.6 else 0.0
    lean = np.radians([rng.uniform(-12, 12), heading, rng.uniform(-12, 12)])
    # Layers of cloth and hidden faces give some limbs more surface than others.
    weights = body.weights @ np.exp(rng.normal(size=len(joints)) * rng.uniform(0, 0.5))
    return normalization.occupancy(points @ rotvec_to_rotmat(lean).T, weights)


def draw_people(count: int, seed: int, kinds: tuple[str, ...] = KINDS) -> np.ndarray:
    """Draw features (count, C), with new points of the body every 50 people; one in four sets are vertices."""
    body, features = load_body(), []
    points = body
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        if i % 50 == 0:
            points = surface_body(body, rng, by_area=(i // 50) % 4 != 3)
        features.append(draw_person(points, kinds[i % len(kinds)], rng))
    return np.array(features, np.float32)


def mirrored(features: np.ndarray) -> np.ndarray:
    """Exchange left and right, which keeps the facing and doubles the data."""
    cells = features.reshape(-1, normalization.GRID, normalization.GRID, normalization.GRID)
    return cells[:, ::-1].reshape(features.shape)


def loss_and_gradient(
    model: dict[str, np.ndarray], features: np.ndarray, rng: np.random.Generator, sampled: int = 4
) -> tuple[float, dict[str, np.ndarray]]:
    """Compute the mean cross-entropy of the 24 rotations and its gradient.

    Of the 20 rotations that are not upright, `sampled` random ones are used, with their scores corrected for it.
    """
    rotations = np.concatenate([TURNS, rng.choice(OTHERS, sampled, replace=False)])
    turned = features[:, normalization.TURNED_CELLS[rotations]]
    hidden = np.maximum(turned @ model["hidden"] + model["bias"], 0)
    scores = hidden @ model["out"]
    scores[:, len(TURNS) :] += np.log(np.float32(len(OTHERS) / sampled))
    probability = np.exp(scores - scores.max(axis=1, keepdims=True))
    probability /= probability.sum(axis=1, keepdims=True)
    correct = TURNS.index(UPRIGHT)
    loss = float(-np.log(probability[:, correct] + 1e-30).mean())
    probability[:, correct] -= 1
    error = probability / len(features)
    inner = error[..., None] * model["out"] * (hidden > 0)
    return loss, {
        "hidden": turned.reshape(-1, turned.shape[-1]).T @ inner.reshape(-1, inner.shape[-1]),
        "bias": inner.sum(axis=(0, 1)),
        "out": np.einsum("br,brh->h", error, hidden),
    }


def fit(features: np.ndarray, steps: int, seed: int, batch: int = 128) -> dict[str, np.ndarray]:
    """Train with Adam: linear decay, single precision, L2 regularisation of the first layer."""
    rng = np.random.default_rng(seed)
    model = {
        "hidden": rng.normal(size=(features.shape[1], HIDDEN)) / 3,
        "bias": np.zeros(HIDDEN),
        "out": rng.normal(size=HIDDEN) / np.sqrt(HIDDEN),
    }
    model = {name: value.astype(np.float32) for name, value in model.items()}
    first = {name: np.zeros_like(value) for name, value in model.items()}
    second = {name: np.zeros_like(value) for name, value in model.items()}
    for step in range(steps):
        people = features[rng.integers(len(features), size=batch)]
        loss, gradient = loss_and_gradient(model, mirrored(people) if step % 2 else people, rng)
        gradient["hidden"] += 1e-5 * model["hidden"]
        rate = 1e-2 * (1 - step / steps)
        for name, value in gradient.items():
            first[name] += 0.1 * (value - first[name])
            second[name] += 0.01 * (value * value - second[name])
            model[name] -= (rate * first[name] / (np.sqrt(second[name]) + 1e-8)).astype(np.float32)
        if step % 200 == 0:
            print(f"step {step} loss {loss:.4f}", flush=True)
    return {name: value.astype(np.float16) for name, value in model.items()}


def report(model: dict[str, np.ndarray], count: int, seed: int) -> None:
    """Print accuracy and calibration on held-out people, one line per kind of pose."""
    for kind in KINDS:
        scores = normalization.orientation_scores(draw_people(count, seed, (kind,)), model)
        right = scores.argmax(axis=1) == UPRIGHT
        chance = np.exp(scores - scores.max(axis=1, keepdims=True))
        chance = np.sort(chance / chance.sum(axis=1, keepdims=True), axis=1)
        sure = chance[:, -1] - chance[:, -2] >= normalization.UNSURE
        print(f"{kind}: right {right.mean():.4f}, sure {sure.mean():.4f}, right when sure {right[sure].mean():.4f}")


def main() -> None:
    """Train and save the detector, or print what it detects in files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "-o", "--output", type=Path, default=Path(normalization.__file__).with_name("frame_orientation.npz")
    )
    parser.add_argument("--people", type=int, default=60000)
    parser.add_argument("--steps", type=int, default=16000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", nargs="*", type=Path, help="fit nothing: print what is found in these files")
    arguments = parser.parse_args()
    if arguments.check is not None:
        from mimesh.io import load_mesh

        for path in arguments.check:
            found = normalization.Normalization.fit(load_mesh(path))
            print(f"{path.name:40s} up {found.up} front {found.front} margin {found.margin:.3f}")
        return
    model = fit(draw_people(arguments.people, arguments.seed), arguments.steps, arguments.seed)
    np.savez_compressed(arguments.output, allow_pickle=False, **model)
    report({name: value.astype(np.float64) for name, value in model.items()}, 1000, arguments.seed + 1)


if __name__ == "__main__":
    main()
