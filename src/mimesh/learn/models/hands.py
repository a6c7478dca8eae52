"""hands: predict the fingers of a hand from points of its surface, with the layers of `mime`.

The network is `mime`'s with the joints of one hand, in the frame of its hand joint; right hands are mirrored. It also
tells whether the hand shows separate fingers at all.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn

from ...bodies.hands import left_hand_body
from .mime import MimeConfig, MimeNetwork, Prediction, rms_normalize

HAND_POINTS = 256
"""Points of a hand that the network takes."""


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

    def estimate_flops(self, vertices: int, points: int) -> float:
        """Count floating-point operations for one hand; `mime`'s count is that of a pair."""
        return super().estimate_flops(vertices, points) / 2
