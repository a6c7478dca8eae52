"""Build src/mimesh/bodies/contacts.npz: people with self-contacts for the training of mime. About ten minutes.

    python research/recipes/build_contacts.py [--count N]

Person i is a function of i alone.
"""

from __future__ import annotations

import argparse

import numpy as np

from mimesh.bodies import load_body
from mimesh.bodies.contacts import BANK, CONTACTS, touching
from mimesh.bodies.sampling import lowered_arms, sample_pose, sample_shape
from mimesh.commands.terminal import progress
from mimesh.io.atomic import whole_file

SEED, SPREAD = 31, 1.3
"""Seed of all people; factor on their shape coefficients."""


def main() -> None:
    """Cycle through the kinds of contact, from random positions of the arms; every other person in a Table 6 pose."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000)
    count = parser.parse_args().count
    body, kinds = load_body(), list(CONTACTS)
    shapes = np.stack([sample_shape(body, SEED, i, SPREAD) for i in range(count)])
    poses = []
    with progress("people", quiet=False) as advance:
        for i in range(count):
            rng = np.random.default_rng([SEED, i])
            pose = rng.random() * lowered_arms(body) + (i % 2) * sample_pose(body, SEED, i)
            poses.append(touching(body, shapes[i], pose, kinds[i % len(kinds)], rng))
            if advance is not None:
                advance(i + 1, count)
    with whole_file(BANK) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, shapes=shapes.astype(np.float16), rotvecs=np.stack(poses).astype(np.float16))


if __name__ == "__main__":
    main()
