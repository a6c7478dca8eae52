"""Fit the shipped detector of up and front: python scripts/fit_orientation.py [--check MESH...]

A two-layer network scores the coarse occupancy of a person as each of the 24 axis rotations would show it; the right
one must win (24-way softmax). People, poses and headings are drawn from the shipped body; ten minutes on one core.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.sampling import JOINT_LIMITS, limits_rotvec, rotvec_to_rotmat, sample_pose
from mimesh.core import normalization as frame
from mimesh.core.surface_points import sample_surface

HIDDEN = 64
POINTS = 1200
UPRIGHT = next(r for r, names in enumerate(frame.ORIENTATIONS) if names == ("+y", "+z"))
TURNS = [r for r, (up, _) in enumerate(frame.ORIENTATIONS) if up == "+y"]
"""The upright rotations: front is harder to tell than up, so training sees these for every person."""
OTHERS = [r for r in range(24) if r not in TURNS]
KINDS = ("rest", "arms down", "table 6", "wide")


def surface_body(body: RiggedBody, rng: np.random.Generator, by_area: bool) -> RiggedBody:
    """The body as points: uniform by area (what a mesh shows) or a share of its vertices (what a point cloud shows)."""
    if not by_area:
        keep = rng.choice(len(body.vertices), POINTS, replace=False)
        parts = body.vertices[keep], body.components[:, keep], body.weights[keep]
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
    """Rotation vectors (J, 3) of one pose of the given kind."""
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


def grow(
    body: RiggedBody, vertices: np.ndarray, joints: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Cartoon proportions: large heads, hands and feet, short legs and arms; half of the people keep theirs."""
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
    """Scale what lies below the hips and beyond the shoulders of a T-pose."""
    x, y, z = points.T
    beyond = np.maximum(np.abs(x) - shoulder, 0)
    return np.stack([x - np.sign(x) * beyond * (1 - arms), np.where(y < hip, hip + legs * (y - hip), y), z], axis=1)


def dress(body: RiggedBody, vertices: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cloth, hair and modelling style: a smooth random warp, and for some people hair over and behind the head."""
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
    """Occupancy features of one random person, standing upright within 40 degrees of facing +z."""
    vertices, joints = body.shaped(np.clip(rng.normal(size=len(body.components)), -2.5, 2.5) * rng.uniform(0, 1.4))
    vertices, joints = grow(body, vertices, joints, rng)
    vertices = dress(body, vertices, rng)
    rotation, translation = body.skinning_transforms(joints, rotvec_to_rotmat(draw_pose(body, kind, rng)))
    points = np.einsum("vj,jkl,vl->vk", body.weights, rotation, vertices, optimize=True) + body.weights @ translation
    points = points * np.exp(rng.uniform(-0.15, 0.15, 3))
    if rng.random() < 0.3:  # something carried or worn
        blob = rng.normal(size=(int(rng.integers(20, 200)), 3)) * rng.uniform(0.03, 0.15, 3)
        points[rng.choice(len(points), len(blob), replace=False)] = points[rng.integers(len(points))] + blob
    points = points + rng.normal(size=points.shape) * rng.uniform(0, 0.015)
    heading = rng.uniform(-40, 40) if rng.random() < 0.6 else 0.0
    lean = np.radians([rng.uniform(-12, 12), heading, rng.uniform(-12, 12)])
    # Layers of cloth and hidden faces weigh some limbs more than others.
    weights = body.weights @ np.exp(rng.normal(size=len(joints)) * rng.uniform(0, 0.5))
    return frame.occupancy(points @ rotvec_to_rotmat(lean).T, weights)


def draw_people(count: int, seed: int, kinds: tuple[str, ...] = KINDS) -> np.ndarray:
    """Features (count, C); a new set of body points every 50 people, one in four of them of vertices."""
    body, features = load_body(), []
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        if i % 50 == 0:
            points = surface_body(body, rng, by_area=(i // 50) % 4 != 3)
        features.append(draw_person(points, kinds[i % len(kinds)], rng))
    return np.array(features, np.float32)


def mirrored(features: np.ndarray) -> np.ndarray:
    """Left and right exchanged: the same facing, twice the people."""
    cells = features.reshape(-1, frame.GRID, frame.GRID, frame.GRID)
    return cells[:, ::-1].reshape(features.shape)


def loss_and_gradient(
    model: dict[str, np.ndarray], features: np.ndarray, rng: np.random.Generator, sampled: int = 4
) -> tuple[float, dict[str, np.ndarray]]:
    """Mean cross-entropy of the 24 rotations and its gradient; `sampled` of the 20 overturned ones stand for all."""
    rotations = np.concatenate([TURNS, rng.choice(OTHERS, sampled, replace=False)])
    turned = features[:, frame.TURNED_CELLS[rotations]]
    hidden = np.maximum(turned @ model["hidden"] + model["bias"], 0)
    scores = hidden @ model["out"]
    scores[:, len(TURNS) :] += np.log(np.float32(len(OTHERS) / sampled))
    chance = np.exp(scores - scores.max(axis=1, keepdims=True))
    chance /= chance.sum(axis=1, keepdims=True)
    right = TURNS.index(UPRIGHT)
    loss = float(-np.log(chance[:, right] + 1e-30).mean())
    chance[:, right] -= 1
    error = chance / len(features)
    inner = error[..., None] * model["out"] * (hidden > 0)
    return loss, {
        "hidden": turned.reshape(-1, turned.shape[-1]).T @ inner.reshape(-1, inner.shape[-1]),
        "bias": inner.sum(axis=(0, 1)),
        "out": np.einsum("br,brh->h", error, hidden),
    }


def fit(features: np.ndarray, steps: int, seed: int, batch: int = 128) -> dict[str, np.ndarray]:
    """Adam with a linear decay, single precision, weight decay on the first layer."""
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
    """Accuracy and calibration on people that were not trained on, one line per kind of pose."""
    for kind in KINDS:
        scores = frame.orientation_scores(draw_people(count, seed, (kind,)), model)
        right = scores.argmax(axis=1) == UPRIGHT
        chance = np.exp(scores - scores.max(axis=1, keepdims=True))
        chance = np.sort(chance / chance.sum(axis=1, keepdims=True), axis=1)
        sure = chance[:, -1] - chance[:, -2] >= frame.UNSURE
        print(f"{kind}: right {right.mean():.4f}, sure {sure.mean():.4f}, right when sure {right[sure].mean():.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(frame.__file__).with_name("frame_orientation.npz"))
    parser.add_argument("--people", type=int, default=60000)
    parser.add_argument("--steps", type=int, default=16000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", nargs="*", type=Path, help="fit nothing: print what is found in these files")
    arguments = parser.parse_args()
    if arguments.check is not None:
        from mimesh.io import load_mesh

        for path in arguments.check:
            found = frame.Normalization.fit(load_mesh(path))
            print(f"{path.name:40s} up {found.up} front {found.front} margin {found.margin:.3f}")
        return
    model = fit(draw_people(arguments.people, arguments.seed), arguments.steps, arguments.seed)
    np.savez_compressed(arguments.output, allow_pickle=False, **model)
    report({name: value.astype(np.float64) for name, value in model.items()}, 1000, arguments.seed + 1)


if __name__ == "__main__":
    main()
