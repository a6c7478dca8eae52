"""Tasks are found by name."""

import pytest
import torch

from mimesh.core.errors import InputError
from mimesh.learn.config import load_config
from mimesh.learn.models import NETWORKS, find_task


@pytest.mark.parametrize("network", NETWORKS)
def test_a_task_makes_the_network_of_its_configuration(network):
    config = load_config("small" if network == "hands" else "table", network)
    kind = find_task(network)
    assert isinstance(config, kind.config_type)
    task = kind(config, torch.device("cpu"))
    model = task.make_model()
    assert model.config == config.model
    assert task.flops_per_pair(model) > 1e6
    assert task.onnx_facts(model)["model"] == network


def test_an_unknown_network_is_refused_with_those_there_are():
    with pytest.raises(
        InputError, match=r"gpt: expected a model that can be trained \(npt, aniformer, limp, mime, hands\)"
    ):
        find_task("gpt")
