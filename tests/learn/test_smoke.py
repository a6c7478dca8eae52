"""Overfitting one pair: the error falls thirtyfold in seconds, or something is broken."""

import pytest
import torch

from mimesh.learn.data.people import PairSource
from mimesh.learn.mime import MimeConfig, MimeData, MimeLossConfig, MimeNetwork, SurfaceSource, mime_loss
from mimesh.learn.npt import NPT, NPTConfig, NPTData, npt_loss
from mimesh.learn.task import shipped_body


def test_npt_overfits_one_pair():
    batch = PairSource(NPTData("table6", 64), shipped_body(), torch.device("cpu"), seed=0).batch(1, 0)
    torch.manual_seed(0)
    model = NPT(NPTConfig(encoder=(16, 32, 64), decoder=(67, 32, 16)))
    optimizer = torch.optim.Adam(model.parameters(), lr=5e-3)
    errors = []
    for _ in range(60):
        optimizer.zero_grad()
        result = model(batch.identity, batch.driving)
        npt_loss(result, batch.truth, batch.edges, edges_of_mesh=batch.edges_of_mesh).backward()
        optimizer.step()
        errors.append(float((result - batch.truth).detach().square().sum(-1).mean()))
    assert errors[-1] < errors[0] / 30


@pytest.mark.slow
def test_mime_overfits_one_pair():
    body = shipped_body()
    batch = SurfaceSource(MimeData("wide", 48, "identity"), body, torch.device("cpu"), seed=0).batch(1, 0)
    torch.manual_seed(0)
    model = MimeNetwork(MimeConfig(32, latents=8, blocks=2, refinements=1, near=16, local=16, skinning=16), body)
    optimizer = torch.optim.Adam(model.parameters(), lr=8e-3)
    losses = []
    for _ in range(80):
        optimizer.zero_grad()
        loss = mime_loss(model, batch, MimeLossConfig(weights=0.0))
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] / 30
