"""A file of test garments that is made of the shipped ones, and the folder of the real one."""

import os
from importlib import resources
from pathlib import Path

import numpy as np

from mimesh.bodies.dress import TEST_FILE, TEST_GARMENTS

REAL_FOLDER = os.environ.get("MIMESH_GARMENTS")
"""Folder of the file that research/recipes/build_test_dress.py built; unset, tests of the real garments are skipped."""
STAND_INS = ("tights", "tights", "skirt", "hair", "hair")
"""Shipped garments in place of TEST_GARMENTS."""


def write_test_garments(folder: Path, **changed: np.ndarray) -> Path:
    """Write a file of test garments, with some arrays changed, and return its folder."""
    arrays = {}
    with np.load(str(resources.files("mimesh.bodies") / "dress.npz")) as data:
        arrays["joints"] = data["joints"]
        for name, source in zip(TEST_GARMENTS, STAND_INS, strict=True):
            for key in ("vertices", "faces", "components", "weight_joints", "weights"):
                arrays[f"{name}_{key}"] = data[f"{source}_{key}"]
    np.savez(folder / TEST_FILE, **(arrays | changed))
    return folder
