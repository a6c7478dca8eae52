"""Blend shapes: exact where few are enough, least squares otherwise, and the reported error is the real one."""

import numpy as np
import pytest
import zoo

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, save_clip
from mimesh.io.gltf import clip
from mimesh.io.gltf.clip import fit_blend_shapes


def clip_of(rank: int, frames: int = 12, seed: int = 0) -> Clip:
    """A clip of a grid whose motion has the given rank."""
    rng = np.random.default_rng(seed)
    mesh = zoo.grid(5)
    directions = rng.normal(size=(rank, *mesh.vertices.shape))
    amounts = rng.normal(size=(frames, rank)) * 2.0 ** -np.arange(rank)
    return Clip(mesh, mesh.vertices + np.einsum("tk,kvc->tvc", amounts, directions), 25.0)


def evaluated(clip: Clip, count: int) -> np.ndarray:
    """Evaluate the fitted blend shapes at every frame, as a client does."""
    blend = fit_blend_shapes(clip, count)
    shapes = np.einsum("kt,tvc->kvc", blend.frame_coefficients(), clip.vertices - blend.base)
    return blend.base + np.einsum("tk,kvc->tvc", blend.weights, shapes)


def test_blend_shapes_of_full_rank_are_exact():
    clip = clip_of(3)
    blend = fit_blend_shapes(clip, 8)
    assert blend.weights.shape == (12, 3)
    np.testing.assert_allclose(evaluated(clip, 8), clip.vertices, atol=1e-6)
    assert blend.max_error < 1e-5


def test_blend_shapes_keep_frame_0_and_have_weights_in_0_1():
    blend = fit_blend_shapes(clip_of(8), 3)
    np.testing.assert_allclose(evaluated(clip_of(8), 3)[0], clip_of(8).vertices[0], atol=1e-6)
    np.testing.assert_allclose([blend.weights.min(axis=0), blend.weights.max(axis=0)], [[0] * 3, [1] * 3])


@pytest.mark.parametrize("count", [1, 2, 5])
def test_blend_shapes_report_the_largest_error_and_have_least_squares(count):
    clip = clip_of(8)
    difference = evaluated(clip, count) - clip.vertices
    assert fit_blend_shapes(clip, count).max_error == pytest.approx(np.linalg.norm(difference, axis=-1).max(), rel=1e-4)
    differences = (clip.vertices - clip.vertices[0]).reshape(12, -1)
    least = (np.linalg.svd(differences, compute_uv=False)[count:] ** 2).sum()
    assert (difference**2).sum() == pytest.approx(least, rel=1e-4)


def test_blend_shapes_do_not_depend_on_block_size(monkeypatch):
    whole = fit_blend_shapes(clip_of(8), 3)
    monkeypatch.setattr(clip, "BLOCK_BYTES", 24 * 12 * 4)
    progress_calls = []
    parts = fit_blend_shapes(clip_of(8), 3, lambda done, total: progress_calls.append((done, total)))
    np.testing.assert_allclose(np.abs(parts.weights - 0.5), np.abs(whole.weights - 0.5), atol=1e-5)
    assert parts.max_error == pytest.approx(whole.max_error, rel=1e-4)
    assert progress_calls == [(k, 14) for k in range(1, 15)]


@pytest.mark.parametrize("count", [2, 30])
def test_blend_shapes_read_back_are_within_the_reported_error(count, tmp_path):
    clip = clip_of(8)
    error = save_clip(clip, tmp_path / "a.glb", blendshapes=count)
    loaded = load_clip(tmp_path / "a.glb")
    assert (len(loaded), loaded.fps) == (12, 25.0)
    difference = np.linalg.norm(loaded.vertices - clip.vertices, axis=-1).max()
    assert error == pytest.approx(difference, rel=1e-3, abs=1e-5)


def test_blend_shapes_of_still_clips_and_other_formats_are_refused(tmp_path):
    still = Clip.still(zoo.cube())
    with pytest.raises(InputError, match="expected 1 or more, found 0"):
        fit_blend_shapes(clip_of(2), 0)
    with pytest.raises(InputError, match="expected a clip that moves"):
        fit_blend_shapes(Clip(still.mesh, np.repeat(still.vertices, 3, axis=0)), 2)
    with pytest.raises(InputError, match=r"expected \.glb or \.gltf for blendshapes, found '\.npz'"):
        save_clip(clip_of(2), tmp_path / "a.npz", blendshapes=2)
