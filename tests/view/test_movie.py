"""Movies read back by Pillow: number and duration of frames, colours, cameras."""

import numpy as np
import pytest
import zoo
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, features

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.view import movie

SIZE = (48, 40)


def distinct_frames(frames):
    """Yield frames that all differ."""
    for k in range(frames):
        picture = np.full((20, 30, 3), 200, np.uint8)
        picture[:, : 2 + 2 * k] = [250, 30, 60]
        yield picture


def durations(path):
    """Read the durations of a movie's frames in milliseconds."""
    with Image.open(path) as image:
        found = []
        for k in range(getattr(image, "n_frames", 1)):
            image.seek(k)
            image.load()
            found.append(image.info["duration"])
        return found


def turning_cube(frames=5, fps=10.0):
    mesh = zoo.cube()
    angle = np.linspace(0, 1, frames)
    x, y, z = (mesh.vertices[:, k] for k in range(3))
    turned = [np.stack([np.cos(a) * x + np.sin(a) * z, y, np.cos(a) * z - np.sin(a) * x], axis=1) for a in angle]
    return Clip(mesh, np.stack(turned), fps)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
@pytest.mark.parametrize("fps", [10.0, 24.0, 30.0])
def test_number_and_durations_of_frames_are_preserved(tmp_path, suffix, fps):
    path = tmp_path / f"a{suffix}"
    assert movie.save_movie(distinct_frames(12), path, fps) == 12
    found = durations(path)
    assert len(found) == 12
    assert sum(found) == pytest.approx(12000 / fps, abs=10 if suffix == ".gif" else 1)
    with Image.open(path) as image:
        assert image.size == (30, 20)
        assert image.info["loop"] == 0
        image.seek(11)
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert np.abs(pixels[10, 5] - [250, 30, 60]).max() < 12
    assert np.abs(pixels[10, 28] - 200).max() < 12


@given(count=st.integers(1, 200), fps=st.floats(1, 120), step=st.sampled_from([1, 10]))
def test_durations_are_positive_and_their_running_sum_is_right(count, fps, step):
    found = movie._durations(count, 1000.0 / fps, step)
    assert len(found) == count
    assert min(found) >= step
    if 1000.0 / fps >= step:
        assert np.abs(np.cumsum(found) - 1000.0 / fps * np.arange(1, count + 1)).max() <= step / 2 + 1e-6


def test_a_movie_that_fails_halfway_leaves_no_file(tmp_path):
    def broken():
        yield np.zeros((4, 4, 3), np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        movie.save_movie(broken(), tmp_path / "a.gif")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "frames", "fps", "message"),
    [
        ("a.avi", 2, 10.0, "expected a movie name ending in .webp, .gif or .mp4, found .avi"),
        ("a", 2, 10.0, "found no suffix"),
        ("a.gif", 0, 10.0, "expected at least one frame, found none"),
        ("a.gif", 2, 0.0, "expected a frame rate from 0.001 to 10,000, found 0"),
    ],
)
def test_unwritable_movies_are_refused(tmp_path, name, frames, fps, message):
    with pytest.raises(InputError, match=message):
        movie.save_movie(distinct_frames(frames), tmp_path / name, fps)


def test_webp_without_support_in_pillow_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(features, "check", lambda feature: False)
    with pytest.raises(InputError, match=r"write a \.gif instead"):
        movie.save_movie(distinct_frames(2), tmp_path / "a.webp")
    assert not list(tmp_path.iterdir())


def test_cameras_of_clips_are_fixed_unless_they_track():
    mesh = zoo.cube()
    clip = Clip(mesh, mesh.vertices + np.arange(3)[:, None, None] * [0.0, 0, 1.5], 10.0)
    fixed = [np.asarray(frame).astype(int) for frame in movie.clip_frames(clip, SIZE)]
    assert np.abs(fixed[2] - fixed[0]).max() > 20
    tracked = [np.asarray(frame).astype(int) for frame in movie.clip_frames(clip, SIZE, track=True)]
    assert np.abs(tracked[2] - tracked[0]).max() <= 1


def test_clips_side_by_side_are_synchronous_and_stay_at_their_last_frame():
    long, short = turning_cube(6, 10.0), turning_cube(2, 10.0)
    double = Clip(long.mesh, np.repeat(long.vertices, 2, axis=0), 20.0)
    frames = list(movie.clip_frames([("a", long), ("b", double), ("c", short)], SIZE, clay=True))
    assert len(frames) == 6
    pixels = [np.asarray(frame) for frame in frames]
    panels = [p[: SIZE[1]].reshape(SIZE[1], 3, SIZE[0], 3) for p in pixels]
    for panel in panels:
        np.testing.assert_array_equal(panel[:, 0], panel[:, 1])
    np.testing.assert_array_equal(panels[1][:, 2], panels[5][:, 2])


def test_tints_colour_one_clip_and_leave_the_other():
    blue = (0.3, 0.4, 0.9)
    frame = next(movie.clip_frames([("a", turning_cube()), ("b", turning_cube())], SIZE, tints=[blue, None]))
    left, right = (np.asarray(frame)[SIZE[1] // 2, x].astype(int) for x in (24, 72))
    assert left[2] > left[0] + 20
    assert right[2] < right[0]


def test_the_last_frame_of_a_turn_is_next_to_the_first():
    frames = [np.asarray(frame).astype(int) for frame in movie.turntable_frames(zoo.two_parts(), 8, SIZE)]
    assert len(frames) == 8
    steps = [np.abs(a - b).mean() for a, b in zip(frames, frames[1:] + frames[:1], strict=True)]
    assert steps[-1] < 2 * max(steps[:-1])
