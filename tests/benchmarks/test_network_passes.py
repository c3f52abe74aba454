"""The suites `encoder` and `update` measure what they say, on the fewest clouds."""

import pytest
import torch
from encoder_pass import make_encoder_pass
from network_passes import make_clouds, measure_pass
from update_pass import make_update_pass

OPTIONS = {"batch": 2, "points": 64, "repeats": 1, "threads": 1, "device": "cpu"}


@pytest.mark.parametrize("make", [make_encoder_pass, make_update_pass])
def test_every_encoder_runs(make):
    threads = torch.get_num_threads()
    for name in ("plain, BatchNorm", "plain, bfloat16", "pointnet2", "pointnet"):
        row = measure_pass(make, name, OPTIONS)
        assert row["seconds"] > 0
        assert row["parameters"] > 1e5
    torch.set_num_threads(threads)


def test_clouds_lie_on_a_box():
    clouds = make_clouds(3, 500, seed=0) - torch.tensor([0.0, 0.0, 0.1, 0.0])
    size = torch.tensor([0.06, 0.08, 0.1])
    on_a_side = (clouds[..., :3] == 0) | torch.isclose(clouds[..., :3], size, atol=1e-6)
    assert on_a_side.any(dim=-1).all()
    assert (clouds[..., :3] >= -1e-6).all()
    assert (clouds[..., :3] <= size + 1e-6).all()
