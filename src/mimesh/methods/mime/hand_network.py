"""Run the network of hands: the fingers of a hand from points of its surface, and the weights of any points of it.

The network (`learn.hands`) knows left hands in the frame of the hand's joint; right hands are mirrored for it.
Inputs of the ONNX file are those of the body's network (`joint_network.py`), of B hands at once. Outputs are "rotation"
(B, 16, 3, 3), "joints" (B, 16, 3) and "scores" (B, V, 16) of the hand and its fifteen finger joints, and "separate"
(B,), the logit of whether the hand shows separate fingers.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...core.geometry import MIRROR, angles_between, mirrored_rotations
from .joint_network import CHUNK, NetworkPoints, softmax
from .part_tracking import mean_rotation

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

HAND_ENSEMBLE = 3
"""Predictions for a hand, each from other points. The first one also decides whether there are fingers: logits are
near 10 or -11, hardly ever between. And it gives the weights."""
MAX_SPREAD = 20.0
"""Median angle (degrees) between predictions of a hand and their mean from which on its fingers follow the hand."""


@dataclass(frozen=True, eq=False)
class Hand:
    """The surface of a hand in one frame."""

    side: str
    """Left or Right."""
    rotation: Float[np.ndarray, "3 3"]
    """World rotation of the hand's joint."""
    position: Float[np.ndarray, " 3"]
    """Its position."""
    samples: NetworkPoints
    """Points of its surface, HAND_ENSEMBLE times as many as one prediction takes, or more."""
    queries: NetworkPoints
    """Points whose weights are predicted."""

    def local(self, points: NetworkPoints) -> NetworkPoints:
        """Express points in the frame of the hand's joint, as those of a left hand."""
        turned = NetworkPoints((points.points - self.position) @ self.rotation, points.normals @ self.rotation)
        return turned if self.side == "Left" else turned.mirrored()

    def fingers(
        self,
        rotation: Float[np.ndarray, "16 3 3"],
        joints: Float[np.ndarray, "16 3"],
        shares: Float[np.ndarray, "Q 16"],
    ) -> Fingers:
        """Return the palm and the fingers of a left hand to the world; the predicted wrist is not needed."""
        if self.side == "Right":
            rotation, joints = mirrored_rotations(rotation), joints * MIRROR
        turned, placed = self.rotation @ rotation, joints @ self.rotation.T + self.position
        return Fingers(turned[0], turned[1:], placed[1:], shares)


@dataclass(frozen=True, eq=False)
class Fingers:
    """Fingers of a hand: its palm and fifteen joints in the world, and the weights of its queries."""

    palm: Float[np.ndarray, "3 3"]
    """World rotation of the palm."""
    rotation: Float[np.ndarray, "15 3 3"]
    """World rotation of the finger joints."""
    joints: Float[np.ndarray, "15 3"]
    """Their positions."""
    shares: Float[np.ndarray, "Q 16"]
    """Share of the hand and of its fingers in the weight that the hand has."""

    @property
    def bends(self) -> Float[np.ndarray, "15 3 3"]:
        """Rotation of each joint relative to the palm."""
        return self.palm.T @ self.rotation


@dataclass(frozen=True, eq=False)
class FingerNetwork:
    """A loaded network."""

    session: InferenceSession
    points: int
    """Points of a hand that one prediction takes."""

    def predict(self, hands: list[Hand]) -> list[Fingers | None]:
        """Predict the fingers of hands; None for a hand that does not show any, or whose predictions differ."""
        parts = [self._parts(hand) for hand in hands]
        # Each hand has another number of queries, so the first predictions are single runs.
        first = [
            self._run_in_chunks(part[0], hand.local(hand.queries)) for hand, part in zip(hands, parts, strict=True)
        ]
        shown = [h for h, outputs in enumerate(first) if outputs.separate[0] > 0]
        found: list[Fingers | None] = [None] * len(hands)
        if not shown:
            return found
        others = [points for h in shown for points in parts[h][1:]]
        further = self._run(others, [points[:1] for points in others])  # the network takes no empty queries
        rotations, joints = (
            np.concatenate([np.stack(of_first), rest.reshape(len(shown), -1, *rest.shape[1:])], axis=1)
            for of_first, rest in (
                ([first[h].rotation for h in shown], further.rotation),
                ([first[h].joints for h in shown], further.joints),
            )
        )  # of each hand shown and each of its predictions
        for h, hand_rotations, mean, mean_joints in zip(
            shown, rotations, _mean_rotations(rotations), joints.mean(axis=1), strict=True
        ):
            spread = angles_between(hand_rotations, mean).mean(axis=1)
            if np.median(spread) < MAX_SPREAD:
                found[h] = hands[h].fingers(mean, mean_joints, softmax(first[h].scores[0]))
        return found

    def _parts(self, hand: Hand) -> list[NetworkPoints]:
        """Divide the samples of a hand into those of each prediction."""
        samples = hand.local(hand.samples)
        return [samples[k::HAND_ENSEMBLE][: self.points] for k in range(HAND_ENSEMBLE)]

    def _run_in_chunks(self, points: NetworkPoints, queries: NetworkPoints) -> _Outputs:
        """Run the network on one hand with any number of queries, CHUNK at a time."""
        outputs = [self._run([points], [queries[k : k + CHUNK]]) for k in range(0, len(queries), CHUNK)]
        # All but the scores are the same for all chunks: they do not depend on the queries.
        return dataclasses.replace(outputs[0], scores=np.concatenate([part.scores for part in outputs], axis=1))

    def _run(self, points: list[NetworkPoints], queries: list[NetworkPoints]) -> _Outputs:
        """Run the network on a batch of hands."""
        given = {
            name: np.stack([getattr(part, field) for part in parts]).astype(np.float32)
            for parts, names in ((points, ("points", "normals")), (queries, ("vertices", "vertex_normals")))
            for name, field in zip(names, ("points", "normals"), strict=True)
        }
        found = self.session.run(["rotation", "joints", "scores", "separate"], given)
        return _Outputs(*(np.asarray(array).astype(np.float64) for array in found))


@dataclass(frozen=True, eq=False)
class _Outputs:
    """What the network returns for B hands."""

    rotation: Float[np.ndarray, "B 16 3 3"]
    joints: Float[np.ndarray, "B 16 3"]
    scores: Float[np.ndarray, "B V 16"]
    separate: Float[np.ndarray, " B"]


def _mean_rotations(rotations: Float[np.ndarray, "H K 16 3 3"]) -> Float[np.ndarray, "H 16 3 3"]:
    """Average the K predictions of each hand: `mean_rotation` of the joints of all hands at once."""
    hands, count = rotations.shape[:2]
    return mean_rotation(rotations.swapaxes(0, 1).reshape(count, -1, 3, 3)).reshape(hands, -1, 3, 3)
