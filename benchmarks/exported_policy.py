"""suite=export: the exported network and the runner without torch beside the policy and GraspAgent."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import onnxruntime
import torch
from omegaconf import DictConfig
from torchrl.envs.utils import step_mdp

import torchgrasp
from torchgrasp import GraspAgent, keys
from torchgrasp.deploy.policy_files import export_policy
from torchgrasp.deploy.runner import GraspPolicy
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import RaycastCamera


def benchmark_export(cfg: DictConfig) -> list[dict]:
    """A row of the network alone and one of the whole way: largest differences and milliseconds."""
    options = cfg.export
    policy = torchgrasp.load_policy(str(options.policy))
    objects = ProceduralObjects("val", num_objects=options.objects)
    with tempfile.TemporaryDirectory() as folder:
        network, settings, _ = export_policy(policy, output=f"{folder}/policy.onnx")
        rows = _run(policy, objects, str(network), str(settings), options.states)
    for row in rows:
        action, goal = row["largest_action_difference"], row["largest_goal_difference"]
        ours, theirs = row["exported_milliseconds"], row["torch_milliseconds"]
        print(
            f"{row['what']}: over {row['states']} states actions differ by {action:.1e} at most, goals by "
            f"{goal:.1e}; {ours:.2f} ms, torch {theirs:.2f} ms",
            flush=True,
        )
    return rows


def _run(policy: Any, objects: Any, network: str, settings: str, states: int) -> list[dict]:
    """Whole episodes of the agent in closed loop, until there are so many states."""
    camera = RaycastCamera()
    env = torchgrasp.make_env(policy, objects=objects, num_envs=1, seed=0, target_motion="mixed")
    agent = GraspAgent(policy, intrinsics=camera.intrinsics, T_ee_camera=camera.T_ee_camera)
    runner = GraspPolicy(settings, T_ee_camera=camera.T_ee_camera)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(network, options)
    alone, whole = _Row("network"), _Row("whole way")
    while whole.states < states:
        state: Any = env.reset()
        agent.reset()
        runner.reset()
        for _ in range(env.horizon):
            read = state.select(*policy.in_keys)
            inputs = {name: read[name].numpy() for name in policy.in_keys}
            said = alone.time(lambda read=read: policy(read), exported=False)
            names = [each.name for each in session.get_outputs()]
            out = alone.time(lambda inputs=inputs: session.run(None, inputs), exported=True)
            found = dict(zip(names, out, strict=True))
            alone.compare(said[keys.ACTION], found[keys.ACTION], said.get(keys.GOAL_PREDICTION, None), found)
            shown = {"depth": state[keys.DEPTH][0].numpy(), "mask": state[keys.MASK][0].numpy()}
            joints = state[keys.JOINTS][0].numpy()
            command = whole.time(lambda s=shown, q=joints: agent.act(**s, joints=q), exported=False)
            step = whole.time(lambda s=shown, q=joints: runner.act(**s, joints=q), exported=True)
            whole.compare(command.action, step.action, command.goal, {keys.GOAL_PREDICTION: step.goal})
            state[keys.ACTION] = torch.from_numpy(command.action)[None]
            state = step_mdp(env.step(state))
    return [alone.tell(), whole.tell()]


class _Row:
    """Differences and times of one thing that is exported, and of what it was exported from."""

    def __init__(self, what: str) -> None:
        self.what, self.states = what, 0
        self._action = self._goal = 0.0
        self._spent: dict[bool, list[float]] = {True: [], False: []}

    @torch.no_grad()
    def time(self, work: Callable[[], Any], *, exported: bool) -> Any:
        """What `work` gives, its time noted."""
        started = time.perf_counter()
        result = work()
        self._spent[exported].append(1e3 * (time.perf_counter() - started))
        return result

    def compare(self, action: Any, exported: Any, goal: Any, found: dict[str, Any]) -> None:
        """Note how far one state's actions and goals lie apart."""
        self.states += 1
        self._action = max(self._action, float(np.abs(np.asarray(action) - exported).max()))
        if goal is not None and keys.GOAL_PREDICTION in found:
            off = np.abs(np.asarray(goal) - found[keys.GOAL_PREDICTION])
            self._goal = max(self._goal, float(np.nan_to_num(off).max()))

    def tell(self) -> dict:
        """The row: medians of the times."""
        return {
            "what": self.what,
            "states": self.states,
            "largest_action_difference": self._action,
            "largest_goal_difference": self._goal,
            "torch_milliseconds": float(np.median(self._spent[False])),
            "exported_milliseconds": float(np.median(self._spent[True])),
        }
