"""Engines by name: which there are, and what is said where one is unknown or not installed."""

import subprocess
import sys

import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.sim import MujocoEngine, SapienEngine, make_engine
from torchgrasp.sim.engines import describe_engine


def test_engines_are_chosen_by_name_or_given():
    assert make_engine() == make_engine("sapien") == SapienEngine()
    assert make_engine("mujoco") == MujocoEngine()
    given = MujocoEngine(substeps=3)
    assert make_engine(given) is given


@pytest.mark.parametrize("wrong", ["bullet", None, {"substeps": 4}, MujocoEngine])
def test_what_is_no_engine_is_refused(wrong):
    with pytest.raises(ConfigError, match=r"^engine=.*sapien or mujoco"):
        make_engine(wrong)


@pytest.mark.parametrize("wrong", ["mujoco", 3, ["torchgrasp.sim.MujocoEngine"]])
def test_what_describes_no_engine_is_refused(wrong):
    with pytest.raises(ConfigError, match=r"^engine=.* is no engine's configuration"):
        describe_engine(wrong)


def test_without_mujoco_the_extra_is_named_and_the_other_engine_works():
    code = (
        "import sys; sys.modules['mujoco'] = None; from torchgrasp.sim import make_engine;"
        "print(make_engine('sapien').name); make_engine('mujoco')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "sapien"
    assert 'pip install "torchgrasp[mujoco]"' in done.stderr.splitlines()[-1]
