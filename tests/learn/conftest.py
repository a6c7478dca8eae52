"""Learning tests need the [train] extra and one thread; trainings and networks that several files look at."""

import dataclasses
from functools import cache

import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

from pools import BLOCKS, blocks, write_character  # noqa: E402
from trainings import TINY, losses  # noqa: E402

ANIFORMER = {
    "network": "aniformer",
    "model": {"encoder": [8, 8, 16], "layers": [16], "attention": "frames", "head": "regression"},
    "data": {"kind": "clips80", "vertices": 16},
    "batch": 2,
    "precision": "fp32",
    "learning_rate": 1e-3,
    "losses": {"motion": "off"},
}
MIME = {
    "network": "mime",
    "model": {"width": 16, "latents": 4, "blocks": 2, "refinements": 2, "near": 4, "local": 8, "skinning": 8},
    "data": {"kind": "wide", "vertices": 32, "target_scale": "identity", "body": "quadruped"},
    "batch": 2,
    "precision": "fp32",
}
METRICS = {"seen": 1.0, "unseen": 2.0, "fresh": 3.0, "val": 2.5}


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """The folder of a whole training of TINY, which told its pace; nobody writes into it."""
    from mimesh.learn import loop

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "FIRST_SECONDS", 0.0)
        return loop.train(TINY, tmp_path_factory.mktemp("trained") / "run")


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """Train a network for two steps and export it once: the trained network, its checkpoint, and the .onnx.

    The exporter takes seconds for each network. NPT is the pooled one, whose two meshes may differ in vertex count.
    """
    from mimesh.learn import checkpoint
    from mimesh.learn.config import config_from
    from mimesh.learn.export import export_command
    from mimesh.learn.loop import TrainingRun
    from mimesh.learn.npt import NPTConfig

    pooled = NPTConfig((16, 32, 32), (35, 16, 16), pose_code="global_max")
    configs = {
        "npt": (dataclasses.replace(TINY, model=pooled, precision="fp32"), 8),
        "aniformer": (config_from(ANIFORMER, "test"), 8),
        "mime": (config_from(MIME, "test"), 16),
    }

    @cache
    @torch.enable_grad()  # tests that compare results have none
    def export(network):
        folder = tmp_path_factory.mktemp(network)
        config, bits = configs[network]
        run = TrainingRun.start(config, folder / "none")
        losses(run, 2)
        if network == "mime":  # some layers begin with zeros
            for parameter in run.model.parameters():
                parameter.data += 0.02 * torch.randn_like(parameter)
        run.metrics = METRICS
        run.save(folder / "last.safetensors")
        export_command(folder / "last.safetensors", folder / "net.onnx", bits)
        return *checkpoint.load_model(folder / "last.safetensors"), folder / "net.onnx"

    return export


@pytest.fixture(scope="module")
def tiny_exports(tmp_path_factory):
    """From here on in a file, export a tiny network for every NPT: the exporter, of test_export.py, takes seconds."""
    from networks import stand_in

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mimesh.learn.export.to_onnx", stand_in(tmp_path_factory.mktemp("tiny")))
        yield


@pytest.fixture(scope="session")
def read_back(exported):
    """Load an exported network from its file, once."""
    from mimesh.learn.export import load_exported

    return cache(lambda network: load_exported(exported(network)[2]))


@pytest.fixture(scope="session")
def pool(tmp_path_factory):
    """A pool of two training characters: a whole person, and one of blocks with few joints."""
    from mimesh.bodies import load_body

    folder = tmp_path_factory.mktemp("pool")
    write_character(folder, "whole", split="train", pack="people")
    missing = [name for name in load_body().joint_names if name not in BLOCKS]
    write_character(folder, "blocks", shape=1, split="train", pack="toys", without=missing, spell=blocks)
    return folder
