"""Sheets of pictures: layout, captions, and heat maps."""

import dataclasses

import numpy as np
import pytest
import zoo

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.view import heat, sheet

TILE = (60, 72)


def caption_of(image):
    """Return the caption below a single tile."""
    return np.asarray(image)[TILE[1] :]


def walk(frames=9, step=2.0):
    mesh = zoo.two_parts()
    offsets = np.arange(frames)[:, None, None] * [0, 0, step]
    return Clip(mesh, mesh.vertices + offsets, 24.0)


def test_contact_sheet_has_a_captioned_tile_for_every_mesh():
    items = [(make.__name__, make()) for make in zoo.ZOO]
    one = sheet.contact_sheet(items[:1], tile=TILE)
    page = sheet.contact_sheet(items, columns=4, tile=TILE)
    assert page.size == (4 * one.width, 2 * one.height)
    first = np.asarray(page)[: one.height, : one.width]
    np.testing.assert_array_equal(first, np.asarray(one))
    with pytest.raises(InputError, match="expected at least one mesh"):
        sheet.contact_sheet([])


def test_a_short_last_row_is_centred():
    picture = np.full((10, 20, 3), 9, np.uint8)
    picture[0] = 240  # paper
    tiles = [sheet.captioned(picture, "") for _ in range(3)]
    page = np.asarray(sheet.page(tiles, 2))
    height = tiles[0].height
    assert (page[height + 5, 10:30] == 9).all()
    assert (page[height + 5, :10] > 200).all()


def test_captions_are_drawn_and_shortened_to_the_tile():
    blank = np.full((TILE[1], TILE[0], 3), 240, np.uint8)
    assert (caption_of(sheet.captioned(blank, "")) > 200).all()
    assert (caption_of(sheet.captioned(blank, "cube")) < 120).any()
    long = caption_of(sheet.captioned(blank, "a name far too long for its tile"))
    assert (long[:, [0, -1]] > 200).all()


def test_transfer_sheet_shows_identity_driving_result_and_truth():
    cube, tetrahedron = zoo.cube(), zoo.tetrahedron()
    three = sheet.transfer_sheet(cube, tetrahedron, cube, tile=TILE)
    four = sheet.transfer_sheet(cube, tetrahedron, cube, cube, tile=TILE)
    assert three.width == 3 * TILE[0]
    assert four.width == 4 * TILE[0]
    pixels = np.asarray(four).astype(int)
    result, truth = (pixels[: TILE[1], k * TILE[0] + 6 : (k + 1) * TILE[0]] for k in (2, 3))
    np.testing.assert_array_equal(result, truth)
    driving = pixels[TILE[1] // 2, 3 * TILE[0] // 2]
    assert driving[2] > driving[0]  # slate blue
    moved = cube.with_vertices(cube.vertices + [0.5, 0, 0])  # result and truth share one camera
    pixels = np.asarray(sheet.transfer_sheet(cube, cube, cube, moved, tile=TILE))
    result, truth = (pixels[: TILE[1], k * TILE[0] + 6 : (k + 1) * TILE[0]] for k in (2, 3))
    assert (result != truth).any()


def test_strip_follows_the_subject_and_has_the_requested_number_of_frames():
    page = np.asarray(sheet.strip(walk(), frames=4, tile=TILE)).astype(int)
    assert page.shape[1] == 4 * TILE[0]
    tiles = page[: TILE[1]].reshape(TILE[1], 4, TILE[0], 3)
    for k in range(1, 4):
        assert np.abs(tiles[:, k] - tiles[:, 0]).max() <= 1
    assert sheet.strip(walk(frames=2), frames=8, tile=TILE).width == 2 * TILE[0]


def test_stack_centres_rows():
    row, narrow = sheet.strip(walk(), frames=3, tile=TILE), sheet.strip(walk(), frames=1, tile=TILE)
    both = sheet.stack([row, narrow])
    assert both.size == (row.width, row.height + narrow.height)
    np.testing.assert_array_equal(np.asarray(both)[row.height :, TILE[0] : 2 * TILE[0]], np.asarray(narrow))


def test_heat_colours_get_darker_all_the_way_and_clip_at_both_ends():
    colors = heat.heat_colors(np.linspace(0, 1, 40))
    lightness = colors @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) < 0.01).all()
    np.testing.assert_array_equal(heat.heat_colors(np.array([-1.0, 2.0])), heat.heat_colors(np.array([0.0, 1.0])))


def test_heat_map_has_the_colour_of_large_errors_where_the_error_is():
    cube = zoo.cube()
    bent = cube.vertices + np.where(cube.vertices[:, 1:2] > 0.5, [0.0, 0.02, 0.0], 0.0)
    pixels = np.asarray(heat.heat_map(cube.with_vertices(bent), cube, tile=TILE)).astype(int)
    picture = pixels[: TILE[1], : TILE[0]]
    warmth = picture[..., 0] - picture[..., 1]
    assert warmth[: TILE[1] // 2].max() > 60
    assert pixels.shape[1] > TILE[0]


def test_heat_map_of_no_error_is_drawn_and_another_topology_refused():
    cube = zoo.cube()
    assert heat.heat_map(cube, cube.vertices, tile=TILE).width > TILE[0]
    with pytest.raises(InputError, match="cube: expected the truth to have 8 vertices, found 4"):
        heat.heat_map(cube, dataclasses.replace(zoo.tetrahedron()))
