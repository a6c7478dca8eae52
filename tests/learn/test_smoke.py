"""One pair must be learnt by heart: PMD falls a hundredfold in seconds, or something is broken."""

import torch

from mimesh.bodies import load_body
from mimesh.learn.batches import DataConfig, PairSource
from mimesh.learn.losses import npt_loss
from mimesh.learn.npt import NPT, NPTConfig


def test_overfits_one_pair():
    batch = PairSource(DataConfig("table6", 128), load_body(), torch.device("cpu"), seed=0).batch(1, 0)
    torch.manual_seed(0)
    model = NPT(NPTConfig(encoder=(32, 64, 128), decoder=(131, 64, 32)))
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    errors = []
    for _ in range(250):
        optimizer.zero_grad()
        result = model(batch.identity, batch.driving)
        npt_loss(result, batch.truth, batch.identity, batch.edges, edges_of_mesh=batch.edges_of_mesh).backward()
        optimizer.step()
        errors.append(float((result - batch.truth).detach().square().sum(-1).mean()))
    assert errors[-1] < errors[0] / 100
