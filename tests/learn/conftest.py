
    _m.pose_bank = lambda s: _n.zeros((9, 31, 3), "float32")
"""Learning tests need the [train] extra and one thread."""

import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
