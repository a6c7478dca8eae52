"""Validation: each frame is compared with its own truth, whatever the network."""

import pytest
import torch

from mimesh.learn.aniformer import AniFormerConfig, AniFormerData, AniFormerTrainConfig
from mimesh.learn.models import find_task
from mimesh.learn.npt import NPTData, NPTTrainConfig
from mimesh.learn.validation import Validation, to_unit_sphere

OPTIONS = ("clips80", 2100)
CONFIGS = {
    "npt": NPTTrainConfig(data=NPTData(*OPTIONS), validation_pairs=1),
    "aniformer": AniFormerTrainConfig(data=AniFormerData(*OPTIONS), validation_pairs=1),
    "regression": AniFormerTrainConfig(
        data=AniFormerData(*OPTIONS), validation_pairs=1, model=AniFormerConfig(head="regression")
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("network", CONFIGS)
def test_each_frame_is_compared_with_its_own_truth(network, monkeypatch):
    """A network that gives the truth makes no error, and one that is a frame late makes some."""
    config = CONFIGS[network]
    task = find_task(config.network)(config, torch.device("cpu"))
    trial = Validation(task).trial("unseen", 0)
    first = (len(trial.clip) - 3) // 2
    model = task.make_model()

    def in_unit_spheres(frames, start):
        return torch.stack([to_unit_sphere(v.astype(float), task.device)[0] for v in frames[start : start + 3]])

    def truth_of(late):
        def forward(identity, driving):
            assert torch.equal(driving.view(3, -1, 3), in_unit_spheres(trial.clip.vertices, first))
            answer = in_unit_spheres(trial.truth_frames, first - late)
            return {"aniformer": answer[None], "regression": answer[None, 1:2]}.get(network, answer)

        return forward

    errors = []
    for late in (0, 1):
        monkeypatch.setattr(model, "forward", truth_of(late))
        errors.append(task.trial_error(model, trial))
    assert errors[0] < 1e-9 < 1e-6 < errors[1]
