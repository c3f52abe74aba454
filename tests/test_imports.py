"""What is imported loads nothing that its user does not need: each case in an interpreter of its own."""

import json
import subprocess
import sys

import pytest

# Simulators and what goes with them, and configuration: no part of a learner's project.
HEAVY = {"sapien", "embreex", "hydra", "omegaconf", "trimesh", "mujoco"}
TORCHRL = {"tensordict", "torchrl"}
UNWANTED = {
    "torchgrasp": HEAVY | TORCHRL | {"torch"},
    "torchgrasp.ops": HEAVY | TORCHRL,
    "torchgrasp.modules": HEAVY | {"torchrl"},
    # Together in one interpreter: what none of them may load, all of them do not.
    "torchgrasp.objectives, torchgrasp.data, torchgrasp.runs, torchgrasp.training": HEAVY,
}


def find_loaded(modules):
    """Names of the top-level modules that are loaded once `modules` alone are imported."""
    # TorchRL loads mujoco by itself where it is installed; an import of ours would fail here.
    hidden = "sys.modules['mujoco'] = None"
    loaded = "sorted({m.split('.')[0] for m in sys.modules if sys.modules[m] is not None})"
    code = f"import json, sys; {hidden}; import {modules}; print(json.dumps({loaded}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("modules", UNWANTED)
def test_importing_a_part_loads_nothing_unwanted(modules):
    assert not find_loaded(modules) & UNWANTED[modules]


def test_without_sapien_losses_work_and_the_simulation_says_what_to_install():
    parts = "import torchgrasp.objectives, torchgrasp.data, torchgrasp.envs, torchgrasp.deploy"
    world = (
        "from torchgrasp.objects import ProceduralObjects; from torchgrasp.envs import GraspEnv;"
        "GraspEnv(1, objects=ProceduralObjects('train', num_objects=1, num_grasps=100)).reset()"
    )
    code = f"import sys; sys.modules['sapien'] = None; {parts}; print('loaded'); {world}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "loaded"
    assert "MissingPackageError: The simulation needs sapien" in done.stderr.splitlines()[-1]
    assert "pip install sapien" in done.stderr.splitlines()[-1]
