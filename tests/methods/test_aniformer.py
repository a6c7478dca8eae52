"""AniFormer at run time: windows of a clip, blending of their results, ensembles, and files that are refused."""

import weakref

import numpy as np
import pytest
from networks import write_sequence_network
from people import person, walk

from mimesh.methods.find import find_model
from mimesh.methods.npt import OVERLAP, AniFormerMethod, blended, middles, windows
from mimesh.pipeline import animate

HEADS = ["frames", "regression"]


def numbered(count: int):
    return [np.full((2, 3), float(t)) for t in range(count)]


@pytest.fixture(params=HEADS)
def network(request, tmp_path):
    pytest.importorskip("onnx")
    return str(write_sequence_network(tmp_path / "tiny.onnx", head=request.param))


@pytest.mark.parametrize("count", range(7))
@pytest.mark.parametrize(("length", "stride"), [(k, s) for k in range(1, 5) for s in range(1, k + 1)])
def test_blending_of_unchanged_frames_returns_the_clip(count, length, stride):
    """If the network returns its input, both kinds of blending return the clip, for any clip and window length."""
    frames = numbered(count)
    all_of_window = list(blended(iter(frames), lambda window: window, length, stride))
    middle = list(middles(iter(frames), lambda window: window[length // 2][None], length))
    for results in (all_of_window, middle):
        assert len(results) == count
        assert all(np.allclose(a, b, rtol=0, atol=1e-12) for a, b in zip(results, frames, strict=True))


def test_every_window_of_a_clip_is_run_once():
    for stride, expected in {1: [0, 1, 2, 3], 2: [0, 2, 3], 3: [0, 3]}.items():
        found = list(windows(iter(numbered(6)), 3, stride))
        assert [start for start, _, _ in found] == expected
        assert [window[0, 0, 0] for _, window, _ in found] == expected
    assert [count for _, _, count in windows(iter(numbered(2)), 3, 2)] == [2]
    assert [w[:, 0, 0].tolist() for _, w, _ in windows(iter(numbered(2)), 4, 3)] == [[0, 1, 1, 1]]


@pytest.mark.parametrize(("stride", "starts"), [(1, (0, 1, 2, 3)), (2, (0, 2, 3)), (3, (0, 3))])
def test_blending_weights_are_a_triangle_over_the_window(stride, starts):
    """Naive implementation: the result of the window from s on is 10 s + offset; weights are 1, 2, 1."""
    runs = iter(starts)

    def run(window):
        s = next(runs)
        return np.stack([np.full((2, 3), 10.0 * s + offset) for offset in range(3)])

    found = [result[0, 0] for result in blended(iter(numbered(6)), run, 3, stride)]
    weights, results = (1, 2, 1), {(s, o): 10 * s + o for s in starts for o in range(3)}
    for t in range(6):
        contributions = [(weights[t - s], results[s, t - s]) for s in starts if 0 <= t - s < 3]
        assert found[t] == pytest.approx(sum(w * x for w, x in contributions) / sum(w for w, _ in contributions))


@pytest.mark.parametrize("head", HEADS)
def test_memory_does_not_grow_with_the_clip(head):
    alive: list[weakref.ref] = []

    def frames():
        for _ in range(40):
            frame = np.zeros((2, 3))
            alive.append(weakref.ref(frame))
            assert sum(ref() is not None for ref in alive) <= 6
            yield frame
            del frame

    if head == "regression":
        results = middles(frames(), lambda window: window[:1], 3)
    else:
        results = blended(frames(), lambda window: window, 3, 3 - OVERLAP)
    assert sum(1 for _ in results) == 40


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_clip_of_any_length_gives_as_many_frames(network, count):
    assert animate(person(0), walk(frames=count), network).clip.vertices.shape[0] == count


def test_ensemble_is_the_mean_of_its_pairings(network):
    method = find_model(network, ensemble=3)
    assert isinstance(method, AniFormerMethod)
    rng = np.random.default_rng(0)
    identity, window = rng.normal(size=(30, 3)), rng.normal(size=(3, 50, 3))
    pairings = [method._pairing(k, 30, 50) for k in range(3)]
    singles = []
    for identity_order, driving_order in pairings:
        inputs = {"identity": identity[None, identity_order], "driving": window[None][:, :, driving_order]}
        result = method.session.run(["result"], {k: v.astype(np.float32) for k, v in inputs.items()})[0][0]
        singles.append(result[:, np.argsort(identity_order)])
    assert np.allclose(method._run(identity, window, pairings), np.mean(singles, axis=0), atol=1e-6)
