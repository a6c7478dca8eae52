"""Train the shipped detector of up and front axes: python research/recipes/fit_orientation.py

A two-layer network scores the occupancy grid of a person in each of the 24 axis rotations; the loss is the 24-way
cross-entropy of the correct one. People are random variants of the shipped body; with --characters half of the
training are figures: the characters of a pool (split train) and people of primitives, with random proportions and
props. The shipped detector combines one of people only and one of both, six minutes each on one core:

    python research/recipes/fit_orientation.py --hidden 64 --people 60000 --steps 16000 -o people.npz
    python research/recipes/fit_orientation.py --characters DIR -o both.npz
    python research/recipes/fit_orientation.py --combine people.npz both.npz --characters DIR

`--measure` prints how often a detector is right on held-out people and characters, `--check MESH...` what the shipped
one finds in files.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.character_pool import PoolCharacter, read_pool
from mimesh.bodies.sampling import JOINT_LIMITS, limits_rotvec, rotvec_to_rotmat, sample_pose
from mimesh.core import normalization
from mimesh.core.surface_points import sample_surface

HIDDEN = 128
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
"""Kinds of poses of the shipped body's people."""
FIGURE_KINDS = {"own rest": 0.3, "arms down": 0.2, "table 6": 0.15, "wide": 0.05, "clip": 0.3}
"""Kinds of poses of figures, and their shares; "own rest" is the rest pose of a character's file."""
STANDING = 0.7
"""Smallest vertical component of the axes of hips and chest of a figure that stands: cosine of 45 degrees."""
HOLES = 0.08
"""Share of figures that lack the points within a ball."""
BATCH = 100
"""Figures that are posed at a time."""
THRESHOLDS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)
"""Margins that `normalization.UNSURE` is chosen from."""
CLIP_FRAMES = 6
"""Frames, evenly spread, that are measured of each clip of a character."""


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
    return turned_occupancy(points, body.weights, rng)


def turned_occupancy(points: np.ndarray, joint_weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Compute the features of upright points (N, 3), turned by up to 40 degrees and leaning a little."""
    heading = rng.uniform(-40, 40) if rng.random() < 0.6 else 0.0
    lean = np.radians([rng.uniform(-12, 12), heading, rng.uniform(-12, 12)])
    # Layers of cloth and hidden faces give some limbs more surface than others.
    weights = joint_weights @ np.exp(rng.normal(size=joint_weights.shape[1]) * rng.uniform(0, 0.5))
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


def draw_figures(folder: Path, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw features (count, C) of figures, upright and within 40 degrees of facing +z, and the pack of each.

    Figures and their points are those of the training of `mime` (`learn.data.figures`), even by area.
    """
    import torch

    from mimesh.learn.data.characters import TrainingCharacters
    from mimesh.learn.data.figures import CharacterBank, FigureSampler
    from mimesh.learn.data.primitives import primitive_people

    body = load_body()
    characters = TrainingCharacters.read(folder, body)
    surfaces = [*characters.surfaces, *primitive_people(body)]
    bank, sampler = CharacterBank(surfaces, body), FigureSampler(surfaces, body, torch.device("cpu"))
    frames = standing_poses(body, characters.poses)[0]
    features, packs = [], []
    for start in range(0, count, BATCH):
        generator, rng = torch.Generator().manual_seed(seed * 10**6 + start), np.random.default_rng([seed, start])
        figures = sampler.draw(BATCH, generator)
        index = bank.choose(figures, POINTS, generator, HOLES)
        rotation = draw_figure_poses(body, bank, figures.which, frames, rng)
        posed = bank.posed(figures, bank.shaped(figures, index), rotation)
        for points, weights in zip(posed.points.double().numpy(), posed.weights.double().numpy(), strict=True):
            stretched = points * np.exp(rng.uniform(-0.15, 0.15, 3))
            noisy = stretched + rng.normal(size=points.shape) * rng.uniform(0, 0.015)
            # Few points stand for the large faces of figures with few of them.
            kept = rng.permutation(POINTS)[: int(rng.integers(60, 400)) if rng.random() < 0.3 else POINTS]
            features.append(turned_occupancy(noisy[kept], weights[kept], rng).astype(np.float32))
        packs += [surfaces[k].pack for k in figures.which.tolist()]
    return np.array(features[:count]), np.array(packs[:count])


def standing_poses(body: RiggedBody, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Select the poses (P, J, 3) in which hips and chest are upright, and turn them so that the hips face +z.

    Returns their local rotations (S, J, 3, 3), the turns (S, 3, 3), and which poses they are (P,).
    """
    import torch

    from mimesh.learn.data.bodies import world_rotations

    local = rotvec_to_rotmat(poses)
    world = world_rotations(torch.from_numpy(local), body.parents).numpy()
    upright = world[:, [body.joint("Hips"), body.joint("Spine1")], 1, 1].min(axis=1) > STANDING
    x, z = world[upright, body.joint("Hips")][:, [0, 2], 2].T
    turn = rotvec_to_rotmat(np.stack([np.zeros_like(x), -np.arctan2(x, z), np.zeros_like(x)], axis=1))
    standing = local[upright]
    standing[:, 0] = turn @ standing[:, 0]  # the first joint has no parent
    return standing, turn, upright


def draw_figure_poses(body: RiggedBody, bank, which, frames: np.ndarray, rng: np.random.Generator):
    """Draw world rotations (B, J, 3, 3) of the joints of figures `which` of a bank; frames of clips are given."""
    import torch

    from mimesh.learn.data.bodies import world_rotations

    kinds = rng.choice(list(FIGURE_KINDS), len(which), p=list(FIGURE_KINDS.values()))
    local = np.tile(np.eye(3), (len(which), len(body.parents), 1, 1))
    for i, kind in enumerate(kinds):
        if kind == "clip":
            local[i] = frames[rng.integers(len(frames))]
        elif kind != "own rest":
            local[i] = rotvec_to_rotmat(draw_pose(body, kind, rng))
    known = bank.turning(which)[..., None, None]
    posed = world_rotations(torch.where(known, torch.from_numpy(local).float(), torch.eye(3)), body.parents)
    return torch.where(torch.from_numpy(kinds == "own rest")[:, None, None, None], bank.alignment[which], posed)


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


def fit(features: np.ndarray, steps: int, seed: int, units: int = HIDDEN, batch: int = 128) -> dict[str, np.ndarray]:
    """Train with Adam: linear decay, single precision, L2 regularisation of the first layer."""
    rng = np.random.default_rng(seed)
    model = {
        "hidden": rng.normal(size=(features.shape[1], units)) / 3,
        "bias": np.zeros(units),
        "out": rng.normal(size=units) / np.sqrt(units),
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


def character_features(character: PoolCharacter) -> tuple[np.ndarray, np.ndarray]:
    """Compute the features of a character at rest (1, C) and in standing frames of its clips (F, C), facing +z."""
    from scipy.spatial.transform import Rotation

    from mimesh.evaluate.characters import body_pose

    rig = character.rig
    moves = [
        character.clip_transforms(name, int(frame))
        for name, clip in character.clips.items()
        for frame in np.unique(np.linspace(0, len(clip) - 1, CLIP_FRAMES).round())
    ]
    features = [normalization.mesh_occupancy(rig.mesh)]
    if moves:
        poses = np.array([Rotation.from_matrix(body_pose(character, move)).as_rotvec() for move in moves])
        _, turns, standing = standing_poses(load_body(), poses)
        for turn, move in zip(
            turns, (move for move, stands in zip(moves, standing, strict=True) if stands), strict=True
        ):
            posed = dataclasses.replace(rig.mesh, vertices=rig.skinned(move) @ turn.T)
            features.append(normalization.mesh_occupancy(posed))
    return np.array(features[:1]), np.array(features[1:]).reshape(-1, normalization.GRID**3)


def pool_features(folder: Path, split: str, packs: list[str] | None = None) -> dict[str, np.ndarray]:
    """Compute the features of the characters of a split, by pack and kind: at rest, and in frames of clips."""
    features: dict[str, list[np.ndarray]] = {}
    for character in read_pool(folder, split).characters:
        pack = character.meta.pack
        if packs is None or pack in packs:
            for kind, found in zip(("rest", "clips"), character_features(character), strict=True):
                features.setdefault(f"{pack} {kind}", []).append(found)
    return {name: np.concatenate(found) for name, found in features.items() if sum(map(len, found))}


def held_out_features(arguments: argparse.Namespace) -> dict[str, np.ndarray]:
    """Compute the features of all sets that detectors are measured on, none of which they were trained on."""
    features = {f"people {kind}": draw_people(arguments.measured_people, arguments.seed + 1, (kind,)) for kind in KINDS}
    if arguments.characters is not None:
        features |= pool_features(arguments.characters, "val")
        if arguments.without:
            left_out = pool_features(arguments.characters, "train", arguments.without)
            features |= {f"without {name}": rows for name, rows in left_out.items()}
    return features


def report(model: dict[str, np.ndarray], features: dict[str, np.ndarray]) -> None:
    """Print how often a detector is right, and how often a threshold of the margin leads to a note."""
    print(f"{'set':32s} {'known':5s} {'count':>5s} {'right':>6s}   noted of wrong, of right; median margin of wrong")
    columns = {"none": list(range(24)), "up": TURNS}
    totals: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {known: [] for known in columns}
    for name, rows in features.items():
        scores = normalization.orientation_scores(rows.astype(np.float64), model)
        upright = np.isin(scores.argmax(axis=1), TURNS)
        print(f"{name + ', only up':32s} none  {len(rows):5d} {upright.mean():6.3f}")
        for known, candidates in columns.items():
            totals[known].append(decisions(scores[:, candidates], candidates.index(UPRIGHT)))
            print_shares(name, known, *totals[known][-1], normalization.UNSURE)
    for known, parts in totals.items():
        right, margin = (np.concatenate(part) for part in zip(*parts, strict=True))
        for threshold in sorted({*THRESHOLDS, normalization.UNSURE}):
            print_shares(f"all, threshold {threshold}", known, right, margin, threshold)


def decisions(scores: np.ndarray, correct: int) -> tuple[np.ndarray, np.ndarray]:
    """Tell which rows of scores are highest in the correct column, and compute their margins."""
    chance = np.exp(scores - scores.max(axis=1, keepdims=True))
    ranked = np.sort(chance / chance.sum(axis=1, keepdims=True), axis=1)
    return scores.argmax(axis=1) == correct, ranked[:, -1] - ranked[:, -2]


def print_shares(name: str, known: str, right: np.ndarray, margin: np.ndarray, threshold: float) -> None:
    """Print one line of the report."""
    noted = margin < threshold
    of_wrong, of_right = (f"{noted[which].mean():.3f}" if which.any() else "-" for which in (~right, right))
    median = f"{np.median(margin[~right]):.3f}" if not right.all() else "-"
    print(f"{name:32s} {known:5s} {len(right):5d} {right.mean():6.3f}   {of_wrong:>5s} {of_right:>5s} {median:>5s}")


def combined(paths: list[Path], shares: list[float]) -> dict[str, np.ndarray]:
    """Combine detectors to one network whose scores are theirs times the shares, added up."""
    models = [load_detector(path) for path in paths]
    model = {name: np.concatenate([model[name] for model in models], axis=-1) for name in ("hidden", "bias")}
    model["out"] = np.concatenate([share * model["out"] for share, model in zip(shares, models, strict=True)])
    return {name: value.astype(np.float16) for name, value in model.items()}


def load_detector(path: Path) -> dict[str, np.ndarray]:
    """Load the weights of a detector."""
    with np.load(path) as data:
        return {name: data[name].astype(np.float64) for name in data.files}


def main() -> None:
    """Train, save and measure a detector, measure a saved one, or print what the shipped one finds in files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    shipped = Path(normalization.__file__).with_name("frame_orientation.npz")
    parser.add_argument("-o", "--output", type=Path, default=shipped, help="the detector (default: the shipped one)")
    parser.add_argument(
        "--characters", type=Path, help="folder of a pool: half of the training, and of what is measured"
    )
    parser.add_argument("--without", nargs="*", default=[], help="packs of the pool to leave out, and to measure")
    parser.add_argument("--people", type=int, default=24000, help="people of the shipped body, and as many figures")
    parser.add_argument("--measured-people", type=int, default=1000, help="held-out people a kind")
    parser.add_argument("--hidden", type=int, default=HIDDEN, help="units of the hidden layer")
    parser.add_argument("--steps", type=int, default=14000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--combine", nargs="+", type=Path, help="fit nothing: save a combination of these detectors")
    parser.add_argument("--shares", nargs="+", type=float, default=[0.3, 0.7], help="of the combined detectors' scores")
    parser.add_argument("--measure", action="store_true", help="fit nothing: measure the detector OUTPUT")
    parser.add_argument("--check", nargs="*", type=Path, help="fit nothing: print what is found in these files")
    arguments = parser.parse_args()
    if arguments.check is not None:
        from mimesh.io import load_mesh

        for path in arguments.check:
            found = normalization.Normalization.fit(load_mesh(path))
            print(f"{path.name:40s} up {found.up} front {found.front} margin {found.margin:.3f}")
        return
    if arguments.combine is not None:
        np.savez_compressed(arguments.output, allow_pickle=False, **combined(arguments.combine, arguments.shares))
    elif not arguments.measure:
        features = draw_people(arguments.people, arguments.seed)
        if arguments.characters is not None:
            figures, packs = draw_figures(arguments.characters, arguments.people, arguments.seed)
            figures = figures[~np.isin(packs, arguments.without)]
            features = np.concatenate([features[: len(figures)], figures])
        model = fit(features, arguments.steps, arguments.seed, arguments.hidden)
        np.savez_compressed(arguments.output, allow_pickle=False, **model)
    report(load_detector(arguments.output), held_out_features(arguments))


if __name__ == "__main__":
    main()
