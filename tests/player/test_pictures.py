"""Textures are read whatever their kind, and those that are damaged are not."""

import io
import warnings

import numpy as np
import pytest
from PIL import Image

from mimesh.player.pictures import TextureStore
from mimesh.render.textures import decoded

RAMP = np.arange(256, dtype=np.uint8).reshape(16, 16)


def written(image, suffix, **options):
    content = io.BytesIO()
    image.save(content, suffix, **options)
    return content.getvalue()


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGB", "RGBA"])
def test_grey_of_any_kind_is_grey(mode):
    found = decoded(written(Image.fromarray(RAMP).convert(mode), "PNG"))
    np.testing.assert_array_equal(np.asarray(found), np.repeat(RAMP[..., None], 3, axis=2))


def test_sixteen_bits_of_grey_are_eight():
    found = decoded(written(Image.fromarray(RAMP.astype(np.uint16) * 257), "PNG"))
    np.testing.assert_array_equal(np.asarray(found)[..., 1], RAMP)


def test_a_palette_with_transparency_is_read_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert decoded(written(Image.fromarray(RAMP).convert("P"), "PNG", transparency=b"\x00\x80")) is not None


def test_four_inks_are_three_colours():
    found = decoded(written(Image.new("CMYK", (8, 8), (0, 255, 255, 0)), "JPEG"))
    assert np.asarray(found).reshape(-1, 3).mean(axis=0) == pytest.approx([255, 0, 0], abs=12)


@pytest.mark.parametrize("content", [b"", b"\x89PNG nothing", written(Image.fromarray(RAMP), "JPEG")[:150]])
def test_damaged_ones_are_none(content):
    assert decoded(content) is None


def test_large_ones_are_halved_until_they_fit():
    noise = np.random.default_rng(0).integers(0, 256, (1024, 1024, 3), dtype=np.uint8)
    pictures, left_out = TextureStore(), []
    assert pictures.number(written(Image.fromarray(noise), "PNG")) == 0
    (packed,) = pictures.packed(400_000, left_out)
    assert packed["type"] == "image/jpeg"
    assert len(packed["data"]) <= 400_000
    assert left_out == ["textures are shown smaller than they are, to keep this page small"]
