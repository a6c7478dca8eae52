"""Results have the displacement of the driving, in the identity's size."""

import numpy as np
import pytest

from mimesh.core.errors import InputError
from mimesh.methods.base import with_root_motion

SHAPE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])


def test_bounding_boxes_follow_the_drivings_scaled_by_the_first_result():
    frames = [SHAPE + [t, 0, 0] for t in range(3)]

    def shapes(frames):
        return (2 * SHAPE + vertices[0] for vertices in frames)

    results = list(with_root_motion(iter(frames), shapes, "walk"))
    steps = np.diff([result.mean(axis=0) for result in results], axis=0)
    assert np.allclose(np.diff(results, axis=0), steps[:, None], rtol=0, atol=1e-12)
    assert np.allclose(steps, [[np.linalg.norm([1, 2]), 0, 0]] * 2, rtol=0, atol=1e-12)


def test_frame_without_size_is_refused_with_its_number():
    frames = [SHAPE, SHAPE, 0 * SHAPE + 3]
    message = (
        "walk: expected some size in frame 2 of those taken.*repair that frame, or end the clip before it with stop=..."
    )
    with pytest.raises(InputError, match=message):
        list(with_root_motion(frames, iter, "walk"))
