"""Training configurations: shipped ones load, changes apply, and what does not belong is refused."""

import re
from importlib import resources

import pytest
import torch

from mimesh.core.errors import InputError
from mimesh.learn.aniformer import AniFormerConfig
from mimesh.learn.config import config_differences, load_config
from mimesh.learn.models import NETWORKS, find_task
from mimesh.learn.npt import NPTConfig

SHIPPED = sorted(path.name.removesuffix(".yaml") for path in (resources.files("mimesh.learn") / "configs").iterdir())


def test_configurations_take_changes():
    config = load_config("table", changes=["model.blocks=conv", "edge=off", "seed=3", "learning_rate=1e-3"])
    assert (config.model.blocks, config.edge, config.seed, config.learning_rate) == ("conv", "off", 3, 1e-3)
    assert config.model.encoder == load_config("table").model.encoder


@pytest.mark.parametrize(
    ("name", "network", "change", "message"),
    [
        ("table", "npt", "edge", "KEY=VALUE"),
        ("table", "npt", "batch.size=3", "batch to hold keys"),
        ("table", "npt", "bacth=3", "bacth"),
        ("small", "mime", "data.kind=clips", "data, kind: expected table6 or wide, found 'clips'"),
        ("small", "mime", "data.target_scale=truth", "data, target_scale: expected identity, found 'truth'"),
        ("small", "mime", "model.heads=3", "expected heads that divide width 128, found 3"),
        ("small", "mime", "data.character_limits=0.1", "character_limits null without data.characters, found 0.1"),
        ("small", "mime", "data.character_limits=few", r"character_limits: expected float \| None, found 'few'"),
        ("table", "aniformer", "model.head=regression", r"losses\.motion"),
        ("table", "aniformer", "model.layers=[]", "layers: expected the channels of one layer or more, found none"),
        ("table", "aniformer", "model.vertices=6890", "expected data.pairing order with model.vertices, found random"),
    ],
)
def test_changes_are_checked(name, network, change, message):
    with pytest.raises(InputError, match=message):
        load_config(name, network, [change])


def test_paper_configuration_is_the_papers():
    config = load_config("paper")
    assert config.model == NPTConfig()
    assert (config.batch, config.learning_rate, config.pairs) == (8, 5e-5, 200 * 4000)
    assert (config.data.kind, config.data.vertices, config.data.target_scale) == ("table6", 0, "truth")
    assert (config.edge, config.edge_weight) == ("paper", 5e-4)
    assert load_config("gpu").model == NPTConfig()
    assert load_config("gpu", "aniformer").model == AniFormerConfig(attention="frames")


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_configurations_load(name):
    """Those of a network have its name before theirs."""
    network, _, config = name.partition("-")
    loaded = load_config(config, network)
    assert loaded.network == network
    assert loaded.pairs > 0
    if network == "mime":
        assert loaded.data.target_scale == "identity"
        assert loaded.data.vertices >= loaded.model.near


@pytest.mark.parametrize(("given", "found"), [("0", 0.0), ("0.08", 0.08), ("null", None)])
def test_characters_have_a_share_of_joint_limits_of_their_own(given, found):
    config = load_config("small", "mime", ["data.characters=0.5", f"data.character_limits={given}"])
    assert (config.data.character_limits, type(config.data.character_limits)) == (found, type(found))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("batches: 8", "found batches; did you mean batch"),
        ("batch: many", "batch: expected int, found 'many'"),
        ("model: {blocks: magic}", "found 'magic'"),
        ("model: 3", "expected keys and values"),
        ("compile: 1", "expected bool"),
        ("batch: 0", "expected batch of 1 or more, found 0"),
        ("learning_rate: -1", "expected learning_rate of 0 or more, found -1"),
        ("ema: 2", "expected ema of 0 to 1, found 2"),
        ("weight_decay: 0.1", "expected weight_decay 0 with optimizer adam"),
        ("accumulate: 3", "expected accumulate to divide batch, found 3 and 8"),
        ("data: {kind: wide, recombine: 0.5}", "expected data.recombine 0 with wide, found 0.5"),
        ("data: {recombine: 2}", "recombine from 0 to 1, found 2"),
        ("data: {reflect: 2}", "reflect from 0 to 1, found 2"),
        ("data: {colour: 0.5}", "found colour; remove it"),
        ("network: mime", "expected a configuration of npt, found one of mime; train mime"),
    ],
)
def test_configurations_are_checked(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_config(str(path))


def test_differences_are_named_by_their_keys_and_at_most_a_few():
    full, table = load_config("gpu"), load_config("table")
    assert config_differences(full, full) == ""
    changed = load_config("gpu", changes=["data.vertices=1229", "learning_rate=1.0000001", "batch=8", "seed=2"])
    words = config_differences(full, changed).split("; ")
    rate = full.learning_rate
    assert set(words) == {
        f"data.vertices {full.data.vertices} here, 1229 there",
        f"learning_rate {rate} here, 1.0000001 there",
        f"batch {full.batch} here, 8 there",
        "seed 0 here, 2 there",
    }
    assert config_differences(full, changed, ("data", "batch")).count("there") == 2
    many = config_differences(full, table)
    assert many.count(" here, ") == 4
    assert re.search(r"; and \d+ more$", many)
    other = config_differences(full, load_config("gpu", "aniformer"), ("network", "model"))
    assert "network npt here, aniformer there" in other
    assert "none" in config_differences(load_config("table", "mime"), full, ("model",))


@pytest.mark.parametrize("network", NETWORKS)
def test_a_task_makes_the_network_of_its_configuration(network):
    config = load_config("table", network)
    kind = find_task(network)
    assert isinstance(config, kind.config_type)
    task = kind(config, torch.device("cpu"))
    model = task.make_model()
    assert model.config == config.model
    assert task.flops_per_pair(model) > 1e6
    assert task.onnx_facts(model)["model"] == network


def test_an_unknown_network_is_refused_with_those_there_are():
    message = r"gpt: expected a model that can be trained \(npt, aniformer, mime\)"
    with pytest.raises(InputError, match=message):
        find_task("gpt")
