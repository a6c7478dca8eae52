"""Metrics of a result against the truth. Shapes are never broadcast; docstrings state the divisor and the unit.

Two formulas compare vertices, and both centre meshes by their bounding boxes, as the papers' public code does; the
papers do not say by what. `pmd` is Eq. 7 as printed, for a result that lies where the truth does
(`measure.Output.beside`), and `pmd_public` is what NPT's public `evaluate.py` computes; AniFormer's evaluation is not
published. For a result whose box has the truth's centre, Eq. 7 is 3 `pmd_public` / radius².
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import face_vectors, nearest_points
from ..core.normalization import bbox_centre

VERSION = 2
"""Of these figures, in reports, cards and checkpoints; two versions are never compared. Version 1 moved both meshes to
their vertex centroids, and divided by the radius about that of the truth, in both formulas."""


def box_radius(mesh: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T"]:
    """Compute the largest distance of a vertex from the centre of the bounding box: the unit of `pmd`."""
    return np.asarray(np.linalg.norm(mesh - bbox_centre(mesh)[..., None, :], axis=-1).max(axis=-1))


def box_aligned(mesh: Float[np.ndarray, "*T V 3"], truth: Float[np.ndarray, "*T W 3"]) -> Float[np.ndarray, "*T V 3"]:
    """Move a mesh so that its bounding box has the centre of the truth's."""
    return mesh + (bbox_centre(truth) - bbox_centre(mesh))[..., None, :]


def resized(mesh: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "W 3"]) -> Float[np.ndarray, "V 3"]:
    """Scale a mesh to the truth's radius, and move it to the centre of the truth's box."""
    return box_aligned(mesh * (box_radius(truth) / box_radius(mesh)), truth)


def pmd(result: Float[np.ndarray, "*T V 3"], truth: Float[np.ndarray, "*S W 3"]) -> float:
    """Compute the point-wise mesh Euclidean distance (NPT Eq. 7; AniFormer Eq. 7, the mean over frames).

    The truth of each frame is in the unit sphere about its box, and the result is where it lies beside it: nothing is
    re-aligned. Squared distances are summed over coordinates, mean over vertices. Papers print it x1e4.
    """
    _same_shape(result, truth)
    return float((np.square(result - truth).sum(axis=-1).mean(axis=-1) / box_radius(truth) ** 2).mean())


def pmd_aligned(result: Float[np.ndarray, "*T V 3"], truth: Float[np.ndarray, "*S W 3"]) -> float:
    """Compute `pmd` of a result whose position is no part of the task: its box gets the centre of the truth's."""
    _same_shape(result, truth)
    return pmd(box_aligned(result, truth), truth)


def pmd_public(result: Float[np.ndarray, "*T V 3"], truth: Float[np.ndarray, "*S W 3"], metres: float = 1.0) -> float:
    """Compute the error of NPT's public `evaluate.py`: mean square of V vertices x 3 coordinates, in metres.

    Each mesh is about the centre of its own box; over frames the mean. `metres` is the length of the meshes' unit.
    """
    _same_shape(result, truth)
    return float(np.square(box_aligned(result, truth) - truth).mean() * metres**2)


def mean_error_mm(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], height: float) -> float:
    """Compute the mean vertex distance in millimetres for a person scaled to 1.7 m, aligned as in `pmd_public`.

    `height` is the person's height at rest, in the meshes' unit.
    """
    return float(np.linalg.norm(box_aligned(result, truth) - truth, axis=-1).mean() * 1.7 / height * 1e3)


def edge_score(
    result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], edges: Int[np.ndarray, "E 2"]
) -> float:
    """Compute the mean over edges of |length / true length - 1|, a measure of rough or stretched surface; 0 is exact.

    Edges with a true length of 0 are left out; the value of a point cloud is 0.
    """
    new, old = (np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) for points in (result, truth))
    valid = old > 0
    return float(np.abs(new[valid] / old[valid] - 1.0).mean()) if valid.any() else 0.0


def largest_stretch(
    result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], edges: Int[np.ndarray, "E 2"]
) -> float:
    """Compute the largest ratio of an edge's length to its true length; 1 is exact.

    Edges shorter than a tenth of the mean true length are left out, since their ratios are dominated by rounding.
    """
    new, old = (np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) for points in (result, truth))
    valid = old >= 0.1 * old.mean() if len(old) else np.zeros(0, bool)
    return float((new[valid] / old[valid]).max(initial=1.0))


def flipped(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    """Compute the fraction of triangles whose normal is more than 90 degrees from that of the truth's triangle."""
    if len(faces) == 0:
        return 0.0
    return float(((face_vectors(result, faces) * face_vectors(truth, faces)).sum(axis=1) < 0).mean())


def chamfer(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "W 3"]) -> float:
    """Compute the chamfer distance: mean squared distance to the nearest vertex of the other set, both ways added.

    In the square of the inputs' unit; vertex counts may differ. It compares vertices, not surfaces, so two different
    meshings of one surface do not give 0.
    """
    to_truth, to_result = nearest_points(truth, result)[0], nearest_points(result, truth)[0]
    return float(np.square(to_truth).mean() + np.square(to_result).mean())


FLOOR_HEIGHT = 0.03
"""Metres for a person of 1.7 m: a vertex can be in contact with the floor only below this height."""
MAX_STANDING_SPEED = 0.1
"""Metres per second for a person of 1.7 m: a vertex near the floor that is slower than this is in contact with it."""


def path_error_mm(result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"], height: float) -> float:
    """Compute the mean distance (mm, for a person of 1.7 m) between the two paths of the vertex centroid.

    Both paths are relative to their frame 0, which counts with distance 0. The centroid is used because a mesh has no
    root joint.
    """
    _same_shape(result, truth)
    result_path, true_path = (clip.mean(axis=1) - clip[0].mean(axis=0) for clip in (result, truth))
    return float(np.linalg.norm(result_path - true_path, axis=1).mean() * 1.7 / height * 1e3)


def jitter(
    result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"], height: float, fps: float
) -> float | None:
    """Compute the mean length (m/s², for a person of 1.7 m) of the difference of the vertices' accelerations.

    Accelerations are second differences, so errors that are equal in all frames do not count. None for fewer than
    three frames.
    """
    _same_shape(result, truth)
    if len(truth) < 3:
        return None
    return float(np.linalg.norm(np.diff(result - truth, 2, axis=0), axis=-1).mean() * fps**2 * 1.7 / height)


def acceleration_ratio(result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"]) -> float | None:
    """Compute the ratio of the mean vertex acceleration of the result to that of the truth (`liveliness` in reports).

    Above 1 the result flickers, below 1 it is too smooth. None for fewer than three frames, and for a truth without
    acceleration.
    """
    _same_shape(result, truth)
    of_result, of_truth = (np.linalg.norm(np.diff(clip, 2, axis=0), axis=-1) for clip in (result, truth))
    return float(of_result.mean() / of_truth.mean()) if of_truth.any() else None


def largest_step_mm(result: Float[np.ndarray, "T V 3"], height: float) -> float:
    """Compute the largest distance (mm, for a person of 1.7 m) that a vertex moves from one frame to the next.

    For a static driving clip the correct value is 0 (`still_mm` in reports).
    """
    return float(np.linalg.norm(np.diff(result, axis=0), axis=-1).max(initial=0.0) * 1.7 / height * 1e3)


def foot_skate(
    result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"], height: float, fps: float
) -> float | None:
    """Compute the mean horizontal speed (cm/s, for a person of 1.7 m) of vertices that are in contact with the floor.

    A vertex is in contact between two frames if, in the truth, it is near the floor in both and hardly moves. The floor
    is the height of the truth's lowest vertex in the clip; hands and knees can be in contact too. None for a clip
    without contact.
    """
    _same_shape(result, truth)
    scale = 1.7 / height
    above_floor = (truth[..., 1] - truth[..., 1].min()) * scale
    speed = np.linalg.norm(np.diff(truth, axis=0), axis=-1) * fps * scale
    near_floor = above_floor < FLOOR_HEIGHT
    contact = near_floor[1:] & near_floor[:-1] & (speed < MAX_STANDING_SPEED)
    if not contact.any():
        return None
    slip = np.linalg.norm(np.diff(result, axis=0)[..., [0, 2]], axis=-1)
    return float(slip[contact].mean() * fps * scale * 100)


def _same_shape(result: np.ndarray, truth: np.ndarray) -> None:
    if result.shape != truth.shape:
        raise ValueError(f"result and truth must have one shape, got {result.shape} and {truth.shape}")
