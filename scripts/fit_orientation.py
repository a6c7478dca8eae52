"""Fit the detector of up and front that `mimesh.frame` ships: python scripts/fit_orientation.py [--check MESH...]

A two-layer network scores the coarse occupancy of a person as each of the 24 axis rotations would show it; the right
one must win (24-way softmax). People, poses and headings are drawn from the shipped body; ten minutes on one core.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from mimesh import frame
from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.sampling import JOINT_LIMITS, limits_rotvec, rotvec_to_rotmat, sample_pose
from mimesh.geometry import sample_surface

HIDDEN = 32
POINTS = 1500
UPRIGHT = next(r for r, names in enumerate(frame.ORIENTATIONS) if names == ("+y", "+z"))
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


def grow(body: RiggedBody, vertices: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cartoon proportions: heads, hands and feet larger or smaller about their joint."""
    for names, low, high in (
        (("Head",), 0.85, 2.0),
        (("LeftHand", "RightHand"), 0.7, 1.6),
        (("LeftFoot", "RightFoot"), 0.7, 1.6),
    ):
        factor = np.exp(rng.uniform(np.log(low), np.log(high)))
        for name in names:
            share = body.weights[:, body.joint(name), None]
            vertices = vertices + share * (factor - 1) * (vertices - body.joints[body.joint(name)])
    return vertices


def draw_person(body: RiggedBody, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Occupancy features of one random person, standing upright within 40 degrees of facing +z."""
    vertices, joints = body.shaped(np.clip(rng.normal(size=len(body.components)), -2.5, 2.5) * rng.uniform(0, 1.4))
    vertices = grow(body, vertices, rng)
    rotation, translation = body.skinning_transforms(joints, rotvec_to_rotmat(draw_pose(body, kind, rng)))
    points = np.einsum("vj,jkl,vl->vk", body.weights, rotation, vertices, optimize=True) + body.weights @ translation
    points = points * np.exp(rng.uniform(-0.15, 0.15, 3))
    if rng.random() < 0.3:  # something carried or worn
        blob = rng.normal(size=(int(rng.integers(20, 200)), 3)) * rng.uniform(0.03, 0.15, 3)
        points[rng.choice(len(points), len(blob), replace=False)] = points[rng.integers(len(points))] + blob
    points = points + rng.normal(size=points.shape) * rng.uniform(0, 0.015)
    heading = rng.uniform(-40, 40) if rng.random() < 0.6 else 0.0
    lean = np.radians([rng.uniform(-12, 12), heading, rng.uniform(-12, 12)])
    points = points @ rotvec_to_rotmat(lean).T
    return frame.occupancy(points * (rng.choice([-1, 1]), 1, 1), np.ones(len(points)))


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


def loss_and_gradient(model: dict[str, np.ndarray], features: np.ndarray) -> tuple[float, dict[str, np.ndarray]]:
    """Mean cross-entropy of the 24 rotations and its gradient."""
    turned = features[:, frame.TURNED_CELLS]
    hidden = np.maximum(turned @ model["hidden"] + model["bias"], 0)
    scores = hidden @ model["out"]
    chance = np.exp(scores - scores.max(axis=1, keepdims=True))
    chance /= chance.sum(axis=1, keepdims=True)
    loss = float(-np.log(chance[:, UPRIGHT] + 1e-30).mean())
    chance[:, UPRIGHT] -= 1
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
        loss, gradient = loss_and_gradient(model, mirrored(people) if step % 2 else people)
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
    parser.add_argument("--people", type=int, default=80000)
    parser.add_argument("--steps", type=int, default=8000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", nargs="*", type=Path, help="fit nothing: print what is found in these files")
    arguments = parser.parse_args()
    if arguments.check is not None:
        from mimesh.io import load_mesh

        for path in arguments.check:
            found = frame.Frame.fit(load_mesh(path))
            print(f"{path.name:40s} up {found.up} front {found.front} margin {found.margin:.3f}")
        return
    model = fit(draw_people(arguments.people, arguments.seed), arguments.steps, arguments.seed)
    np.savez_compressed(arguments.output, allow_pickle=False, **model)
    report({name: value.astype(np.float64) for name, value in model.items()}, 1000, arguments.seed + 1)


if __name__ == "__main__":
    main()
