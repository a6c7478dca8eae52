"""Textures of every kind are decoded, damaged ones are not, and large ones are reduced to the budget."""

import io
import warnings

import numpy as np
import pytest
from PIL import Image

from mimesh.player.pack import TextureStore
from mimesh.render.textures import decode_image

RAMP = np.arange(256, dtype=np.uint8).reshape(16, 16)


def encode(image, suffix, **options):
    """Encode an image in a file format."""
    content = io.BytesIO()
    image.save(content, suffix, **options)
    return content.getvalue()


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGB", "RGBA"])
def test_grey_in_any_mode_is_grey(mode):
    image = decode_image(encode(Image.fromarray(RAMP).convert(mode), "PNG"))
    np.testing.assert_array_equal(np.asarray(image), np.repeat(RAMP[..., None], 3, axis=2))


def test_sixteen_bit_grey_is_converted_to_eight():
    image = decode_image(encode(Image.fromarray(RAMP.astype(np.uint16) * 257), "PNG"))
    np.testing.assert_array_equal(np.asarray(image)[..., 1], RAMP)


def test_a_palette_with_transparency_is_read_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert decode_image(encode(Image.fromarray(RAMP).convert("P"), "PNG", transparency=b"\x00\x80")) is not None


def test_cmyk_is_converted_to_rgb():
    image = decode_image(encode(Image.new("CMYK", (8, 8), (0, 255, 255, 0)), "JPEG"))
    assert np.asarray(image).reshape(-1, 3).mean(axis=0) == pytest.approx([255, 0, 0], abs=12)


@pytest.mark.parametrize("content", [b"", b"\x89PNG nothing", encode(Image.fromarray(RAMP), "JPEG")[:150]])
def test_damaged_files_give_none(content):
    assert decode_image(content) is None


def test_large_textures_are_halved_until_they_fit():
    noise = np.random.default_rng(0).integers(0, 256, (1024, 1024, 3), dtype=np.uint8)
    store, left_out = TextureStore(), []
    assert store.index(encode(Image.fromarray(noise), "PNG")) == 0
    (packed,) = store.pack(400_000, left_out)
    assert packed["type"] == "image/jpeg"
    assert len(packed["data"]) <= 400_000
    assert left_out == ["textures are shown smaller than they are, to keep this page small"]
