"""Learning tests need the [train] extra and one thread."""

import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
