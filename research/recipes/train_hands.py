"""Train the network that finds the fingers of `mime`, src/mimesh/methods/zoo/hands.onnx (pip install -e '.[train]').

The network is that of `mime` with the joints of one hand, in the frame of its hand joint; right hands are mirrored. It
also tells whether the hand shows separate fingers at all.

Batches are left hands in random gestures, as points of their surfaces in the frame of a predicted hand joint.
Lengths are in spreads of the hand: the root mean square distance of its points from their mean, which is the origin.
The axes are those of the palm of the shipped body's left hand in the T-pose, off by the error of the predicted joint.

    python research/recipes/train_hands.py [-o hands.onnx] [--characters pool/] [--minutes 20] [--seed 0]

The state of the training is written every minute beside the output (hands.pt): the same command goes on from there.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from hand_gestures import finger_rotations, left_hand_body, sample_finger_poses
from hand_surfaces import FINGERLESS, HUMAN, HandSurface, training_hands
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from mimesh.bodies import load_body
from mimesh.bodies.hands import HAND_PARENTS
from mimesh.bodies.joint_names import finger_joints
from mimesh.core.errors import InputError
from mimesh.evaluate.character_folder import read_character_folder
from mimesh.evaluate.provenance import commit
from mimesh.io.atomic import together, whole_file
from mimesh.io.gltf.character import NOT_STATED
from mimesh.learn.checkpoint import hardware
from mimesh.learn.data.bodies import (
    gather_points,
    normal,
    numbers_of_step,
    on_device,
    rotvec_to_rotmat,
    scaled_joints,
    skinned_surface,
    uniform,
    world_rotations,
)
from mimesh.learn.data.figures import LAST, pick_rows, rows_by_group
from mimesh.learn.export import STORED_BITS, check_output, save_card, save_network
from mimesh.learn.mime import MimeConfig, MimeNetwork, Prediction, joint_errors, masked_mean, rms_normalize
from mimesh.learn.optimizers import DTYPES, choose_precision, make_optimizers, schedule
from mimesh.learn.task import OnnxInterface, TrainConfig

NETWORK = MimeConfig(width=80, heads=4, latents=12, blocks=3, refinements=2, near=24, local=48, skinning=24)
OPTIMIZER = TrainConfig(batch=32, optimizer="muon", learning_rate=3e-3, warmup=1600, decay=0.8, beta2=0.98)
"""Size of a batch, and how its gradient changes the weights."""
CLIP, AVERAGE = 1.0, 0.998
"""Largest norm of the gradient, and decay of the moving average of the weights, which is written."""
JOINTS, WEIGHTS, SEPARATE = 2.0, 0.05, 0.05
"""Weights of the loss's terms beside the rotations: squared distances of joints in units of the points' spread, and the
cross-entropies of the skinning weights and of whether the hand shows separate fingers."""
CHARACTERS = 0.5
"""Share of characters' hands with fingers in a batch, where a folder of characters is given."""
HAND_POINTS = 256
"""Points of a hand that the network takes."""
QUERIES = 96
"""Points of a hand whose skinning weights are predicted in training."""
GESTURES = 16_384
"""Gestures that a training draws from."""
OWN_REST = 0.25
"""Share of hands with fingers that are in the rest pose of their file."""
FINGERLESS_SHARE = 0.25
"""Share of hands without fingers."""
FRAME_ERROR, WRIST_BEND = math.radians(25), math.radians(60)
"""Largest error of the predicted hand joint's rotation, and largest rotation of the forearm at the wrist (radians)."""
LENGTH_SPREAD, GIRTH_SPREAD = 0.16, 0.12
"""Standard deviation of the logarithms of the lengths of fingers and of the girths of hands; half of the first, and the
second again, are added for each bone."""
LARGEST_LENGTH, LARGEST_GIRTH = 0.5, 0.45
"""Largest absolute value of these logarithms."""
WRIST_CUT = (0.15, 0.85)
"""Range of the weight of the hand from which on the network gets a point: where the forearm is cut off."""
MAX_NOISE = 0.06
"""Largest standard deviation of the noise on points (spreads); mostly it is far less."""
BUMP_HEIGHT, BUMP_FREQUENCY = 0.05, 8.0
"""Largest height of the bumps (spreads) and scale of their frequency (radians a spread)."""
MISSING, MAX_HOLE = 0.15, 0.6
"""Share of hands that lack the points within a ball, and its largest radius (spreads)."""
ONE_SIDED, WITHOUT_NORMALS = 0.1, 0.15
"""Share of hands of which only the points facing one side are given, and share without normals."""
UNSEEN_SEED, TRIAL_SEED = 1, 77
"""Seeds of the people and of the gestures that the network is measured on."""
TRIALS, TRIAL_HANDS = 24, 8
"""Number of batches that it is measured on, and of hands in each."""
LOG_SECONDS, SAVE_SECONDS = 20.0, 60.0
"""Wall-clock time between lines of the log, and between states of the training that are written."""


def main() -> None:
    """Train, write the network with its card, and print its error on hands of people that it has not seen."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("hands.onnx"))
    parser.add_argument("--characters", type=Path, help="Folder of rigged characters, as for `mimesh train mime`.")
    parser.add_argument("--minutes", type=float, default=20.0, help="Processor minutes; with a GPU minutes.")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    check_output(args.output, STORED_BITS[0], STORED_BITS)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    characters = read_character_folder(args.characters).characters if args.characters else ()
    surfaces = training_hands(load_body(), characters)
    source = HandSource(surfaces, device, args.seed, CHARACTERS if characters else 0.0)
    torch.manual_seed(args.seed)
    state = args.output.with_suffix(".pt")
    model, spent = train(HandNetwork(NETWORK).to(device), source, args.minutes, state)
    error = unseen_error(model)
    print(f"mean squared distance of finger joints: {error:.4f} squared spreads of the hand")
    used = ("batch", "optimizer", "learning_rate", "warmup", "decay", "beta2")
    config = {"network": "hands", "model": vars(NETWORK), **{key: getattr(OPTIMIZER, key) for key in used}}
    makers = Counter(f"{c.meta.maker or NOT_STATED}: {c.meta.pack} ({c.meta.licence})" for c in characters)
    card = {
        "name": args.output.stem,
        "file": args.output.name,
        "license": "Apache-2.0",
        "data": DATA,
        "config": config | {"minutes": args.minutes, "clip": CLIP, "ema": AVERAGE, "seed": args.seed},
        "seed": args.seed,
        "commit": commit(),
        "hardware": hardware(),
        **spent,
        **({"characters": {"makers": dict(makers)}} if characters else {}),
        "metrics": {"val": {"unseen_pmd_e4": round(1e4 * error, 3)}},
    }
    with together():
        save_network(onnx_interface(model.cpu()), {**FACTS, "config": vars(NETWORK)}, args.output, STORED_BITS[0])
        save_card(card, args.output)
    state.unlink()


def train(
    model: HandNetwork, source: HandSource, minutes: float, state: Path
) -> tuple[HandNetwork, dict[str, int | float]]:
    """Train a network for some minutes of `time.process_time`, with a GPU of the clock.

    Args:
        state: where the state of the training is written, and read if it is there.

    Returns:
        Its moving average, and how long it was trained.

    Raises:
        InputError: the state is that of a training with another seed.
    """
    clock = time.process_time if source.device.type == "cpu" else time.perf_counter
    precision, reason = choose_precision("auto", source.device)
    print(reason)
    optimizers = make_optimizers(model, OPTIMIZER, source.device, DTYPES[precision])
    average = {name: value.detach().clone() for name, value in model.state_dict().items()}
    started, step, told, saved = clock(), 0, 0.0, time.monotonic()
    if state.exists():
        before = torch.load(state, map_location=source.device, weights_only=True)
        if before["seed"] != source.seed:
            raise InputError(f"{state}: expected a training of seed {source.seed}, found {before['seed']}; delete it")
        model.load_state_dict(before["model"])
        for optimizer, values in zip(optimizers, before["optimizers"], strict=True):
            optimizer.load_state_dict(values)
        average, step, started = before["average"], before["step"], started - before["seconds"]

    def save() -> None:
        facts = {"seed": source.seed, "step": step, "seconds": clock() - started}
        tensors = {"model": model.state_dict(), "average": average}
        with whole_file(state) as temporary:
            torch.save({**facts, **tensors, "optimizers": [each.state_dict() for each in optimizers]}, temporary)

    while (share := (clock() - started) / (60 * minutes)) < 1.0:
        rate = OPTIMIZER.learning_rate * schedule(OPTIMIZER, step * OPTIMIZER.batch, share)
        for optimizer in optimizers:
            for group in optimizer.param_groups:
                group["lr"] = rate
            optimizer.zero_grad(set_to_none=True)
        with torch.autocast(source.device.type, torch.bfloat16, enabled=precision == "bf16"):
            loss = hands_loss(model, source.batch(OPTIMIZER.batch, step))
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), CLIP)
        for optimizer in optimizers:
            optimizer.step()
        for name, value in model.state_dict().items():
            average[name].lerp_(value, 1.0 - AVERAGE)
        step += 1
        if time.monotonic() - told > LOG_SECONDS:
            told = time.monotonic()
            print(f"{share:.0%}, {step * OPTIMIZER.batch:,} hands: loss {float(loss.detach()):.4f}", flush=True)
        if time.monotonic() - saved > SAVE_SECONDS:
            save()
            saved = time.monotonic()
    save()
    model.load_state_dict(average)
    return model.eval(), {"seconds_trained": round(clock() - started), "pairs": step * OPTIMIZER.batch}


@torch.no_grad()
def unseen_error(model: HandNetwork) -> float:
    """Measure the mean of `joint_error` over hands of people that no training gets."""
    device = model.rest_joints.device
    source = HandSource(training_hands(load_body(), (), UNSEEN_SEED), device, TRIAL_SEED, 0.0)
    errors = []
    for step in range(TRIALS):
        batch = source.batch(TRIAL_HANDS, step)
        errors.append(joint_error(model.predict_joints(batch.points, batch.normals), batch)[batch.separate])
    return float(torch.cat(errors).mean())


class HandNetwork(MimeNetwork):
    """Predict joints and skinning weights of left hands, and a logit of whether they show separate fingers."""

    def __init__(self, config: MimeConfig) -> None:
        super().__init__(config, left_hand_body())
        self.separate = nn.Linear(config.width, 1)

    def predict_separate(self, prediction: Prediction) -> Float[Tensor, " B"]:
        """Compute the logit of each hand from the mean of its tokens."""
        return self.separate(rms_normalize(prediction.tokens.mean(1)))[:, 0].float()

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride] (of one mesh, not of a pair)
        self,
        points: Float[Tensor, "B N 3"],
        normals: Float[Tensor, "B N 3"],
        vertices: Float[Tensor, "B V 3"],
        vertex_normals: Float[Tensor, "B V 3"],
    ) -> tuple[Prediction, Float[Tensor, " B"], Float[Tensor, "B V 16"]]:
        """Predict the joints of hands, the logit of separate fingers, and scores of any points of the same hands.

        The logits of skinning weights (scores) are those of the hand and its 15 finger joints.
        """
        prediction = self.predict_joints(points, normals)
        return prediction, self.predict_separate(prediction), self.predict_weights(prediction, vertices, vertex_normals)


@dataclass(frozen=True)
class HandBatch:
    """B hands: what the network is given, and what is true of them. See the module for units and axes."""

    points: Float[Tensor, "B N 3"]
    """With noise, as the queries."""
    normals: Float[Tensor, "B N 3"]
    """Of unit length, or zero where a hand has none."""
    queries: Float[Tensor, "B Q 3"]
    query_normals: Float[Tensor, "B Q 3"]
    query_weights: Float[Tensor, "B Q 16"]
    """Skinning weights of the hand, to which the forearm's are added, and of 15 finger joints, rows sum to 1."""
    rotation: Float[Tensor, "B 16 3 3"]
    """Of the hand and its finger joints from the shipped body's rest pose."""
    joints: Float[Tensor, "B 16 3"]
    separate: Bool[Tensor, " B"]
    """Whether a hand shows separate fingers; if not, weights, rotation and joints mean nothing."""


@cache
def gesture_bank(seed: int) -> Float[np.ndarray, "P 15 3 3"]:
    """Draw the gestures of a training: local rotations of a left hand's joints."""
    return finger_rotations(sample_finger_poses(GESTURES, np.random.default_rng(seed)), left=True)


class HandSource:
    """Makes batches of hands; a batch is a pure function of the seed and its step.

    A batch is drawn in five steps: which hands, rotations of their joints, the posed surfaces, which points of them are
    given, and the errors of these points.
    """

    def __init__(self, surfaces: list[HandSurface], device: torch.device, seed: int, characters: float) -> None:
        """Put the hands on the device.

        Args:
            surfaces: of one group, all or none show separate fingers.
            characters: share of characters' hands with fingers; those without have FINGERLESS_SHARE, the shipped body's
                the rest.
        """
        self.seed, self.device = seed, device
        self.points, self.normals, self.weights, self.joints, self.alignment, self.bones = (
            on_device(np.stack([getattr(surface, name) for surface in surfaces]), device)
            for name in ("points", "normals", "weights", "joints", "alignment", "bones")
        )
        self.separate = torch.tensor([surface.separate for surface in surfaces], device=device)
        self.gestures = on_device(gesture_bank(seed), device)
        self.branching = torch.arange(16, device=device) == 0  # the hand has five bones
        rows = rows_by_group([surface.group for surface in surfaces], device)
        kinds = [group if surfaces[int(some[0])].separate else FINGERLESS for group, some in rows.items()]
        self.rows, self.shares = list(rows.values()), torch.tensor(group_shares(kinds, characters), device=device)

    def batch(self, size: int, step: int) -> HandBatch:
        rng = numbers_of_step(self.seed, step, self.device)
        group = self.shares.multinomial(size, replacement=True, generator=rng)
        which = pick_rows(self.rows, group, uniform(rng, size))
        rotation = self._rotations(which, rng)
        points, normals, joints = self._posed(which, rotation, rng)
        weights, centre = self.weights[which], points.mean(1, keepdim=True)
        spread = _spread(points)
        points, joints = (points - centre) / spread, (joints - centre) / spread
        index = self._choose(points, normals, weights, rng)
        points, normals, weights = (gather_points(values, index) for values in (points, normals, weights))
        noise = MAX_NOISE * uniform(rng, size, 1, 1).pow(3)
        points = points + noise * normal(rng, *points.shape)
        turn = self._turn(rng, size, FRAME_ERROR)
        points, normals, joints = (vectors @ turn.mT for vectors in (points, normals, joints))
        normals = normals * (uniform(rng, size, 1, 1) >= WITHOUT_NORMALS)
        of_hand = torch.cat([weights[..., :2].sum(-1, keepdim=True), weights[..., 2:]], -1)
        given, queries = slice(HAND_POINTS), slice(HAND_POINTS, None)
        return HandBatch(
            points[:, given],
            normals[:, given],
            points[:, queries],
            normals[:, queries],
            of_hand[:, queries],
            turn[:, None] @ rotation,
            joints,
            self.separate[which],
        )

    def _rotations(self, which: Int[Tensor, " B"], rng: torch.Generator) -> Float[Tensor, "B 16 3 3"]:
        """Draw the rotation of every joint in the frame of the palm: that of a gesture, or of the rest pose."""
        size = len(which)
        gesture = torch.randint(GESTURES, (size,), generator=rng, device=self.device)
        hand = torch.eye(3, device=self.device).expand(size, 1, 3, 3)
        posed = world_rotations(torch.cat([hand, self.gestures[gesture]], 1), HAND_PARENTS)
        alignment = self.alignment[which]
        rest = alignment[:, :1].mT @ alignment
        own = uniform(rng, size, 1, 1, 1) < OWN_REST
        return torch.where(own | ~self.separate[which][:, None, None, None], rest, posed)

    def _posed(
        self, which: Int[Tensor, " B"], rotation: Float[Tensor, "B 16 3 3"], rng: torch.Generator
    ) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"], Float[Tensor, "B 16 3"]]:
        """Scale the bones, bend the wrist, add bumps and pose the joints: points, normals and joints."""
        size, rest = len(which), self.joints[which]
        length, girth = self._proportions(size, rng)
        turned = rotation @ self.alignment[which].mT
        joints, linear, normal_map = scaled_joints(
            rest, self.bones[which], self.branching, length, girth, turned, HAND_PARENTS
        )
        # The first of the 17 columns of weights is the forearm's, which turns about the wrist.
        forearm = self._turn(rng, size, WRIST_BEND)[:, None] @ turned[:, :1]
        linear, normal_map = (torch.cat([forearm, maps], 1) for maps in (linear, normal_map))
        centres = torch.cat([rest[:, :1], rest], 1), torch.cat([joints[:, :1], joints], 1)
        bumpy = self._bumpy(which, rng)
        points, normals = skinned_surface(bumpy, self.normals[which], self.weights[which], centres, linear, normal_map)
        return points, normals, joints

    def _proportions(self, size: int, rng: torch.Generator) -> tuple[Float[Tensor, "B 16"], Float[Tensor, "B 16"]]:
        """Draw scales along and across the bones: the lengths of one finger, and the girths of one hand, are alike."""
        fingers = LENGTH_SPREAD * normal(rng, size, 6)  # the hand and five fingers
        length = torch.cat([fingers[:, :1], fingers[:, 1:].repeat_interleave(3, 1)], 1)
        length = length + 0.5 * LENGTH_SPREAD * normal(rng, size, 16)
        girth = GIRTH_SPREAD * (normal(rng, size, 1) + normal(rng, size, 16))
        return length.clamp(-LARGEST_LENGTH, LARGEST_LENGTH).exp(), girth.clamp(-LARGEST_GIRTH, LARGEST_GIRTH).exp()

    def _bumpy(self, which: Int[Tensor, " B"], rng: torch.Generator) -> Float[Tensor, "B N 3"]:
        """Move the points of hands at rest along their normals by a sine wave through space."""
        size, points = len(which), self.points[which]
        spread = _spread(points)
        direction = BUMP_FREQUENCY * normal(rng, size, 1, 3) / spread
        phase = 2 * math.pi * uniform(rng, size, 1, 1)
        height = BUMP_HEIGHT * spread * uniform(rng, size, 1, 1).square()
        wave = ((points * direction).sum(-1, keepdim=True) + phase).sin()
        return points + height * wave * self.normals[which]

    def _choose(
        self,
        points: Float[Tensor, "B N 3"],
        normals: Float[Tensor, "B N 3"],
        weights: Float[Tensor, "B N 17"],
        rng: torch.Generator,
    ) -> Int[Tensor, "B M"]:
        """Choose random points of hands, those that are given and then queries, in random order.

        The points with the smallest keys are taken: random numbers below 1, raised by LAST in a hole and on the side
        that is not given, and by more beyond the wrist. If others are too few, they are repeated.
        """
        size, total = points.shape[:2]
        key = uniform(rng, size, total)
        low, high = WRIST_CUT
        least = low + (high - low) * uniform(rng, size, 1)
        centre = torch.randint(total, (size, 1), generator=rng, device=self.device)
        radius = MAX_HOLE * uniform(rng, size, 1) * (uniform(rng, size, 1) < MISSING)
        in_hole = (points - gather_points(points, centre)).norm(dim=-1) < radius
        side = F.normalize(normal(rng, size, 1, 3), dim=-1)
        hidden = ((normals * side).sum(-1) < 0) & (uniform(rng, size, 1) < ONE_SIDED)
        beyond = weights[..., 1:].sum(-1) < least
        key = key + LAST * (in_hole | hidden) + 2 * LAST * beyond
        order = key.topk(HAND_POINTS + QUERIES, dim=1, largest=False).indices
        enough = (key < LAST).sum(1, keepdim=True).clamp_min(1)
        order = order.gather(1, torch.arange(order.shape[1], device=self.device) % enough)
        shuffled = uniform(rng, size, order.shape[1]).argsort(1)
        return order.gather(1, shuffled)

    def _turn(self, rng: torch.Generator, size: int, largest: float) -> Float[Tensor, "B 3 3"]:
        """Draw rotations about any axis by up to an angle (radians)."""
        axis = F.normalize(normal(rng, size, 3), dim=-1)
        return rotvec_to_rotmat(axis * largest * uniform(rng, size, 1))


def _spread(points: Float[Tensor, "B N 3"]) -> Float[Tensor, "B 1 1"]:
    """Compute the root mean square distance of points from their mean."""
    return (points - points.mean(1, keepdim=True)).square().sum(-1).mean(1).sqrt()[:, None, None]


def group_shares(kinds: list[str], characters: float) -> list[float]:
    """Give the share of each group in a batch by its kind: HUMAN, FINGERLESS, or a pack of characters.

    Args:
        characters: share of all packs together.
    """
    packs = sum(kind not in (HUMAN, FINGERLESS) for kind in kinds)
    share = {
        HUMAN: 1 - FINGERLESS_SHARE - (characters if packs else 0.0),
        FINGERLESS: FINGERLESS_SHARE / max(kinds.count(FINGERLESS), 1),
    }
    return [share.get(kind, characters / max(packs, 1)) for kind in kinds]


def hands_loss(model: nn.Module, batch: HandBatch) -> Float[Tensor, ""]:
    """Compute the errors of rotations, joints and weights of hands with fingers, and of the logits of all."""
    prediction, logit, scores = model(batch.points, batch.normals, batch.queries, batch.query_normals)
    known = batch.separate[:, None]
    rotation, joints = joint_errors(prediction, (batch.rotation, known), (batch.joints, known))
    entropy = -masked_mean((batch.query_weights * scores.log_softmax(-1)).sum(-1), known)
    separate = F.binary_cross_entropy_with_logits(logit, batch.separate.float())
    terms = rotation, JOINTS * joints, WEIGHTS * entropy, SEPARATE * separate
    return torch.stack(terms).sum()


def joint_error(prediction: Prediction, batch: HandBatch) -> Float[Tensor, " B"]:
    """Compute the mean squared distance of the finger joints in squared spreads of the given points."""
    return ((prediction.joints - batch.joints) / prediction.scale)[:, 1:].square().sum(-1).mean(1)


DATA = (
    "hands of random people of the shipped body and of characters, fingers in random gestures; mittens, blocks and "
    "hands without fingers"
)
"""What the card says about the data."""
FACTS = {"model": "hands", "points": HAND_POINTS, "joints": ("LeftHand", *finger_joints("Left"))}
"""What the file says about the network."""


def onnx_interface(model: HandNetwork) -> OnnxInterface:
    """Map points and queries of any number of hands, with normals, to joints, logits and scores."""
    b, v = torch.export.Dim("hands", min=1), torch.export.Dim("vertices", min=1)
    inputs = ("points", "normals", "vertices", "vertex_normals")
    example = (*torch.randn(2, 3, HAND_POINTS, 3), *torch.randn(2, 3, 300, 3))
    dynamic = ({0: b}, {0: b}, {0: b, 1: v}, {0: b, 1: v})
    return OnnxInterface(_Outputs(model), inputs, ("rotation", "joints", "scores", "separate"), example, dynamic)


class _Outputs(nn.Module):
    """All that the network computes, as tensors."""

    def __init__(self, model: HandNetwork) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: Tensor, normals: Tensor, vertices: Tensor, vertex_normals: Tensor):
        prediction, logit, scores = self.model(points, normals, vertices, vertex_normals)
        return prediction.rotation, prediction.joints, scores, logit


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
