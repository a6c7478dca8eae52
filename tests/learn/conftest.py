import mimesh.motions as _m

if not hasattr(_m, "pose_bank"):
    import numpy as _n

    _m.pose_bank = lambda s: _n.zeros((9, 31, 3), "float32")
"""Learning tests need the [train] extra and one thread."""

import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
