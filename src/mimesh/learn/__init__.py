"""Everything that needs torch (the [train] extra): models, losses, data on the device, training and export.

A training in the order in which it happens:

* `start.py` reads the configuration (`config.py`, `configs/`): which model, data, optimizer, length.
* `npt.py`, `aniformer.py`, `mime.py`: one model each, from its options, network and loss to its
  export. `layers.py` has what the papers' networks share. `tests/learn/test_smoke.py` trains NPT in fourteen lines.
* `data/` makes batches: `data/people.py` the papers' people and poses, which `evaluate/protocols.py` fixes by seed, so
  that tests can leave them out; the other files those of `mime`, and what the user brings.
* `loop.py` takes steps (`optimizers.py`), validates (`validation.py`) and saves (`checkpoint.py`).
* `export.py` writes ONNX and a card.
"""
