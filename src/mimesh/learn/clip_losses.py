"""Losses of AniFormer, one function per equation; `signed` ones are the equations as printed, kept to be measured.

As printed Eq. 4 and Eq. 5 are signed differences: the first has no lower bound (and telescopes, so only the first and
the last step of a clip enter), the second is smallest where the mesh is one point. With absolute values both are zero
on sets that hold more than the truth, so neither may stand alone (zero sets: see each function).
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from . import losses
from .losses import edge_vectors

STILL = 1e-6
"""Least mean square step of a driving frame that Eq. 4 divides by (unit sphere: 1e-3 of the radius a frame)."""


def reconstruction(result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"]) -> Float[Tensor, ""]:
    """L_r of Eq. 6: squared distance to the truth, summed over vertices, mean over frames."""
    return losses.reconstruction(result.flatten(0, 1), truth.flatten(0, 1))


def motion_signed(result: Float[Tensor, "B T V 3"], driving: Float[Tensor, "B T U 3"]) -> Float[Tensor, ""]:
    """Eq. 4 as printed: falls without end as the last step of the result grows."""
    return _change_of_ratio(result, driving).mean()


def motion_paper(result: Float[Tensor, "B T V 3"], driving: Float[Tensor, "B T U 3"]) -> Float[Tensor, ""]:
    """Eq. 4 with absolute values: the speed of the result over that of the driving should not change over time.

    Zero for the driving itself in any size and place, and for a static result, and wherever the two speeds are
    proportional. A driving step below `STILL` counts as that.
    """
    return _change_of_ratio(result, driving).abs().mean()


def motion_velocity(result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"]) -> Float[Tensor, ""]:
    """The public code's motion term: squared difference of velocities, summed over vertices, mean over steps.

    Zero for the truth, wherever it stands.
    """
    assert result.shape[1] == truth.shape[1] > 1, "velocities are of at least two frames"
    return reconstruction(result.diff(dim=1), truth.diff(dim=1))


def appearance_signed(
    result: Float[Tensor, "B T V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Eq. 5 as printed: smallest, and negative, where the result is one point. `edges` lists each edge once."""
    return _edge_growth(result, identity, edges).sum(dim=2).mean() * 2.0 / result.shape[2]


def appearance_paper(
    result: Float[Tensor, "B T V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Eq. 5 with absolute values: change of squared edge lengths, summed over neighbours, mean over vertices.

    Zero for whatever keeps the identity's edge lengths, in any pose. A skinned truth stretches some edges, so it is
    not quite zero there.
    """
    return _edge_growth(result, identity, edges).abs().sum(dim=2).mean() * 2.0 / result.shape[2]


def appearance_ratio(
    result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """The public code's appearance term: |length / truth's length - 1|, mean over edges and frames."""
    each_frame = edges.repeat_interleave(result.shape[1], dim=0)
    return losses.edge_ratio(result.flatten(0, 1), truth.flatten(0, 1), each_frame)


def aniformer_loss(
    result: Float[Tensor, "B T V 3"],
    truth: Float[Tensor, "B W V 3"],
    identity: Float[Tensor, "B V 3"],
    driving: Float[Tensor, "B W U 3"],
    edges: Int[Tensor, "B E 2"],
    unit: Float[Tensor, "B W"] | None = None,
    motion: str = "paper",
    motion_weight: float = 1e-3,
    appearance: str = "paper",
    appearance_weight: float = 1e-2,
    edges_of_mesh: float = 1.0,
) -> Float[Tensor, ""]:
    """Eq. 6 with distances and velocities divided by the number of vertices, as Eq. 5 is: L_r is then PMD (Eq. 7).

    The one frame (T = 1) that the regression head gives of a window (W frames) is held to the middle one of the truth;
    motion asks for two frames (`velocity`) or three (`paper`).

    Args:
        unit: radii by which the frames of the truth were divided, over that of the identity. Eq. 5 compares lengths of
            the two, so the result is taken to the identity's unit. None: they have one.
        motion: `paper` (Eq. 4 with absolute values), `velocity` (public code) or `off`.
        appearance: `paper` (Eq. 5 with absolute values), `ratio` (public code) or `off`.
        edges_of_mesh: edges a vertex that the whole mesh has, over those given here, when `edges` is a sample.
    """
    count = result.shape[2]
    truth = middle_of(truth, result.shape[1])
    loss = reconstruction(result, truth) / count
    if motion == "paper":
        loss = loss + motion_weight * motion_paper(result, driving)
    elif motion == "velocity":
        loss = loss + motion_weight * motion_velocity(result, truth) / count
    if appearance == "paper":
        sized = result if unit is None else result * middle_of(unit, result.shape[1])[..., None, None]
        loss = loss + appearance_weight * edges_of_mesh * appearance_paper(sized, identity, edges)
    elif appearance == "ratio":
        loss = loss + appearance_weight * appearance_ratio(result, truth, edges)
    return loss


def middle_of(truth: Shaped[Tensor, "B W ..."], frames: int) -> Shaped[Tensor, "B T ..."]:
    """What a result is held to: all frames of a window, or the middle one where the head gives one."""
    return truth if frames == truth.shape[1] else truth[:, truth.shape[1] // 2, None]


def _change_of_ratio(result: Float[Tensor, "B T V 3"], driving: Float[Tensor, "B T U 3"]) -> Float[Tensor, "B S"]:
    """From each step to the next (S = T - 2): squared speed over the driving's squared speed, the earlier less."""
    assert result.shape[1] == driving.shape[1] > 2, "Eq. 4 compares the steps of at least three frames"
    # Means over the vertices where the paper has sums: the ratio is the same, and meshes of two sizes compare.
    moved, wanted = (clip.diff(dim=1).square().sum(dim=3).mean(dim=2) for clip in (result, driving))
    return -(moved / wanted.clamp_min(STILL)).diff(dim=1)


def _edge_growth(
    result: Float[Tensor, "B T V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, "B T E"]:
    """Squared length of each edge less that in the identity."""
    new = [edge_vectors(frame, edges).square().sum(dim=2) for frame in result.unbind(1)]
    return torch.stack(new, dim=1) - edge_vectors(identity, edges).square().sum(dim=2)[:, None]
