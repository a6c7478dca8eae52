"""Hands for training: exact poses, hands without fingers, and the network of one hand."""

import dataclasses
import json

import numpy as np
import pytest
import ship_weights
import torch
from hand_surfaces import (
    HAND_COLUMN,
    HUMAN,
    HandMesh,
    blocks,
    hands_of_character,
    hands_of_people,
    mittens,
    posed_hand,
    stumps,
)
from pools import write_character
from train_hands import (
    HAND_POINTS,
    OPTIMIZER,
    QUERIES,
    HandNetwork,
    HandSource,
    hands_loss,
    joint_error,
    main,
    train,
)

from mimesh.bodies import load_body
from mimesh.bodies.character_pool import read_pool
from mimesh.bodies.hands import HAND_PARENTS
from mimesh.core.errors import InputError
from mimesh.core.skinning import skinning_transforms
from mimesh.learn.mime import MimeConfig

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def people():
    return hands_of_people(load_body(), np.random.default_rng(0), 3)


@pytest.fixture(scope="module")
def surfaces(people):
    rng = np.random.default_rng(1)
    whole = [hand.surface(HUMAN, rng, clusters) for hand, clusters in zip(people, (0, 170, 300), strict=True)]
    return [*whole, *stumps(people, rng), *blocks(rng)[:4]]


@pytest.fixture(scope="module")
def source(surfaces):
    return HandSource(surfaces, CPU, 0, 0.0)


def test_hands_of_people_have_weights_and_joints(people):
    hand = people[0]
    assert np.allclose(hand.weights.sum(axis=1), 1.0)
    assert (hand.weights[:, 2:].sum(axis=0) > 1).all()  # each joint moves some vertices
    assert np.allclose(posed_hand(hand, np.tile(np.eye(3), (15, 1, 1))), hand.vertices)


def test_hands_of_characters_are_cut_out_with_their_joints(tmp_path):
    write_character(tmp_path, "man", 0, fingers=True, palms=True)
    write_character(tmp_path, "mitten", 0, without=[f"Left{part}" for part in ("Hand", "FingerBase", "HandFinger1")])
    whole, mitten = (hands_of_character(character) for character in read_pool(tmp_path, "val").characters)
    assert [separate for _, separate in whole] == [True, True]
    assert [separate for _, separate in mitten] == [False]  # the right hand
    for mesh, _ in [*whole, *mitten]:
        assert np.allclose(mesh.weights.sum(axis=1), 1.0)
        assert (mesh.joints[1:, 0] >= mesh.joints[0, 0]).all()  # left hands point to +x
    assert whole[0][0].weights[:, HAND_COLUMN].max() > 0.99  # the palm's own joint counts as the hand
    assert (mitten[0][0].joints == mitten[0][0].joints[0]).all()
    assert mitten[0][0].weights[:, :2].sum(axis=1) == pytest.approx(1.0)


def test_simplified_hands_keep_all_fingers(people):
    simple = people[0].simplified(170)
    assert len(simple.vertices) == 170
    assert np.allclose(simple.weights.sum(axis=1), 1.0)
    assert (np.bincount(simple.weights.argmax(axis=1), minlength=17)[2:] >= 3).all()


def test_right_hands_become_left_ones(people):
    hand = people[0]
    mirrored = HandMesh.cut(
        hand.vertices * (-1, 1, 1), hand.faces[:, ::-1], hand.weights, hand.joints * (-1, 1, 1), left=False
    )
    whole = HandMesh.cut(hand.vertices, hand.faces, hand.weights, hand.joints, left=True)
    assert np.allclose(mirrored.vertices, whole.vertices)
    assert np.array_equal(np.sort(mirrored.faces, axis=1), np.sort(whole.faces, axis=1))


def test_hands_without_fingers_have_unit_normals_that_point_outwards(people):
    rng = np.random.default_rng(2)
    for surface in (*mittens(people, rng)[:6], *blocks(rng)[:6]):
        assert not surface.separate
        assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
        assert ((surface.points - surface.points.mean(axis=0)) * surface.normals).sum(axis=1).mean() > 0


def test_batches_are_functions_of_their_step(source):
    first, again, other = source.batch(8, 3), source.batch(8, 3), source.batch(8, 4)
    for field in dataclasses.fields(first):
        assert torch.equal(getattr(first, field.name), getattr(again, field.name))
    assert not torch.equal(first.points, other.points)
    assert first.points.shape == (8, HAND_POINTS, 3)
    assert first.queries.shape == (8, QUERIES, 3)
    assert torch.allclose(first.query_weights.sum(-1), torch.ones(8, QUERIES), atol=1e-5)
    assert torch.allclose(first.rotation @ first.rotation.mT, torch.eye(3).expand(8, 16, 3, 3), atol=1e-4)


def test_joints_of_a_posed_hand_are_where_forward_kinematics_puts_them(people, monkeypatch):
    for name in ("LENGTH_SPREAD", "GIRTH_SPREAD", "MAX_NOISE", "BUMP_HEIGHT", "FRAME_ERROR", "OWN_REST"):
        monkeypatch.setattr(f"train_hands.{name}", 0.0)
    hand = people[0].surface(HUMAN, np.random.default_rng(1))
    batch = HandSource([hand], CPU, 0, 0.0).batch(8, 0)
    turned = batch.rotation.numpy() @ hand.alignment.swapaxes(-1, -2)
    for world, joints in zip(turned, batch.joints.numpy(), strict=True):
        local = np.stack([world[0], *(world[p].T @ turn for p, turn in zip(HAND_PARENTS[1:], world[1:], strict=True))])
        rotation, translation = skinning_transforms(hand.joints, local, HAND_PARENTS)
        posed = (rotation @ hand.joints[..., None])[..., 0] + translation
        found, posed = joints - joints[0], posed - posed[0]
        assert np.allclose(found / np.linalg.norm(found), posed / np.linalg.norm(posed), atol=1e-4)


def test_network_of_hands_learns_and_its_rotations_are_rotations(source):
    model = HandNetwork(MimeConfig(width=16, blocks=1, refinements=1, heads=2))
    batch = source.batch(8, 0)
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    losses = []
    for _ in range(25):
        optimizer.zero_grad()
        loss = hands_loss(model, batch)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.8 * losses[0]
    prediction, logit, scores = model(batch.points, batch.normals, batch.queries, batch.query_normals)
    assert torch.allclose(prediction.rotation @ prediction.rotation.mT, torch.eye(3).expand(8, 16, 3, 3), atol=1e-4)
    assert logit.shape == (8,)
    assert scores.shape == (8, QUERIES, 16)
    with torch.no_grad():
        assert torch.isfinite(joint_error(prediction, batch)).all()


def test_training_goes_on_from_its_last_state(surfaces, tmp_path, monkeypatch):
    source = HandSource(surfaces, CPU, 0, 0.0)
    small = MimeConfig(width=16, blocks=1, refinements=1, heads=2)
    monkeypatch.setattr("train_hands.SAVE_SECONDS", 0.0)
    losses = []

    def failing(model, batch):
        losses.append(hands_loss(model, batch))
        if len(losses) == 3:
            raise KeyboardInterrupt
        return losses[-1]

    monkeypatch.setattr("train_hands.hands_loss", failing)
    state = tmp_path / "hands.pt"
    with pytest.raises(KeyboardInterrupt):
        train(HandNetwork(small), source, 60.0, state)
    saved = torch.load(state, weights_only=True)
    assert (saved["step"], [path.name for path in tmp_path.iterdir()]) == (2, ["hands.pt"])
    monkeypatch.setattr("train_hands.hands_loss", hands_loss)
    model, spent = train(HandNetwork(small), source, saved["seconds"] / 60 + 1e-6, state)
    assert spent["pairs"] in (2 * OPTIMIZER.batch, 3 * OPTIMIZER.batch)
    again = torch.load(state, weights_only=True)
    assert again["seconds"] > saved["seconds"]
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, again["average"][name])
    source.seed = 5
    with pytest.raises(InputError, match="expected a training of seed 5, found 0; delete it"):
        train(HandNetwork(small), source, 60.0, state)


def test_the_command_writes_the_network_and_its_card(surfaces, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("train_hands.training_hands", lambda *_: surfaces)
    monkeypatch.setattr("train_hands.NETWORK", MimeConfig(width=16, blocks=1, refinements=1, heads=2))
    monkeypatch.setattr("train_hands.TRIALS", 1)
    monkeypatch.setattr("sys.argv", ["train_hands.py", "--minutes", "1e-3"])
    main()
    assert {path.name for path in tmp_path.iterdir()} == {"hands.onnx", "hands.json"}
    card = json.loads((tmp_path / "hands.json").read_text())
    assert card["pairs"] >= OPTIMIZER.batch
    assert card["metrics"]["val"]["unseen_pmd_e4"] > 0
    assert (card["config"]["network"], card["config"]["model"]["width"]) == ("hands", 16)


def test_better_networks_of_fingers_are_shipped(tmp_path, monkeypatch):
    monkeypatch.setattr(ship_weights, "ZOO", tmp_path / "zoo")
    for path, error in (("zoo/hands.onnx", 2.0), ("worse.onnx", 3.0), ("better.onnx", 1.0)):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(path)
        card = {"name": path[:-5], "metrics": {"val": {"unseen_pmd_e4": error}}}
        (tmp_path / path).with_suffix(".json").write_text(json.dumps(card))
    ship_weights.ship_hands(tmp_path / "worse.onnx")
    assert (tmp_path / "zoo/hands.onnx").read_text() == "zoo/hands.onnx"
    ship_weights.ship_hands(tmp_path / "better.onnx")
    assert (tmp_path / "zoo/hands.onnx").read_text() == "better.onnx"
    card = json.loads((tmp_path / "zoo/hands.json").read_text())
    assert (card["name"], card["file"], card["metrics"]["val"]["unseen_pmd_e4"]) == ("hands", "hands.onnx", 1.0)
    with pytest.raises(InputError, match=r"none\.onnx: expected a network and its card of train_hands\.py, found none"):
        ship_weights.ship_hands(tmp_path / "none.onnx")
