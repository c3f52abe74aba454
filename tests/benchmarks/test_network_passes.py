"""The suites `encoder`, `update` and `neighbours` measure what they say, on the fewest clouds."""

import pytest
import torch
from encoder_pass import make_encoder_pass
from kept_update import compare_kept
from neighbours import measure_neighbours
from network_passes import make_clouds, measure_pass
from omegaconf import OmegaConf
from update_pass import make_batch, make_update_pass

OPTIONS = {"batch": 2, "points": 64, "repeats": 1, "threads": 1, "device": "cpu"}


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (make_encoder_pass, ("plain, BatchNorm", "plain, bfloat16", "pointnet2", "pointnet")),
        (make_update_pass, ("plain", "pointnet")),
    ],
)
def test_every_encoder_runs(make, names):
    threads = torch.get_num_threads()
    for name in names:
        row = measure_pass(make, name, OPTIONS)
        assert row["seconds"] > 0
        assert row["parameters"] > 1e5
    torch.set_num_threads(threads)


def test_updates_on_kept_features_are_the_faster():
    cfg = OmegaConf.create({"clouds": {"threads": torch.get_num_threads(), "repeats": 1}})
    anew, kept = compare_kept(cfg, make_batch(32, 512))
    assert all(anew[kind] > kept[kind] > 0 for kind in ("imitation", "critic", "actor"))


def test_an_update_is_timed_beside_none_one_and_a_process_a_core():
    threads = torch.get_num_threads()
    times = measure_neighbours(True, 2, {"batch": 64, "points": 16, "seconds": 0.01})
    assert len(times) == 3 and min(times) > 0
    torch.set_num_threads(threads)


def test_clouds_lie_on_a_box():
    clouds = make_clouds(3, 500, seed=0) - torch.tensor([0.0, 0.0, 0.1, 0.0])
    size = torch.tensor([0.06, 0.08, 0.1])
    on_a_side = (clouds[..., :3] == 0) | torch.isclose(clouds[..., :3], size, atol=1e-6)
    assert on_a_side.any(dim=-1).all()
    assert (clouds[..., :3] >= -1e-6).all()
    assert (clouds[..., :3] <= size + 1e-6).all()
