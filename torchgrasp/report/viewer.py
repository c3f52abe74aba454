"""A page in the browser on which episodes are watched while they are run."""

from __future__ import annotations

import contextlib
import io
import socket
from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.geometry import goal_to_pose
from torchgrasp.report.drawing import observed_points
from torchgrasp.report.page_origin import refuse_other_pages
from torchgrasp.report.viewer_panel import FASTEST, SLOWEST, Skipped, ViewerPanel
from torchgrasp.report.viewer_scene import ViewerScene
from torchgrasp.rollouts.episode_pool import Episode
from torchgrasp.sim.robot_look import RobotLookName, check_robot

# Seconds that an episode's result stands.
_RESULT = 1.0
# Grasps that a policy writes, and the colours that they are drawn in.
_GRASPS = {keys.GOAL: (0.10, 0.62, 0.25), keys.GOAL_PREDICTION: (0.80, 0.10, 0.65)}


class EpisodeViewer:
    """Serves a page and draws on it what a watched policy does in the first world of its environment.

    The page shows robot, table and target where the physics has them, the cloud of POINTS in blue, the
    grasp of GOAL_PREDICTION in magenta and that of GOAL (the expert's, or a goal network's) in green, each
    where the policy writes it. The page sets speed, pause, next episode and policy. It needs the extra `viz`.

    Args:
        policies: names that the page lets choose from; the first plays first.
        host: address to listen on; 127.0.0.1 serves this machine alone, 0.0.0.0 everyone in its network.
        port: to listen on; 0 for any that is free.
        speed: that playing begins with, times real time.
        step_seconds: that a step of the policy lasts.
        robot: "meshes" draws the Panda as it looks where its meshes are installed (extra `random-urdfs`),
            "shapes" what collides.

    Attributes:
        scene: what is drawn.
        panel: the controls.
        address: of the page.

    Example:
        >>> from torchgrasp.objects import ProceduralObjects
        >>> from torchgrasp.planning import RandomAction
        >>> env = GraspEnv(1, objects=ProceduralObjects("train", num_objects=1, num_grasps=100), horizon=2)
        >>> with EpisodeViewer(policies=["random"], port=0, speed=10.0, robot="shapes") as viewer:
        ...     steps = env.rollout(2, viewer.watch(RandomAction(), env))
        ...     len(viewer.scene.robot)
        18
    """

    def __init__(
        self,
        *,
        policies: Sequence[str],
        host: str = "127.0.0.1",
        port: int = 8080,
        speed: float = 1.0,
        step_seconds: float = 0.15,
        robot: RobotLookName = "meshes",
    ) -> None:
        check_range("speed", speed, SLOWEST, FASTEST)
        check_whole("port", port, 0)
        check_robot(robot)
        check_viewer_tools()
        import viser

        port = _free_port(host, port)
        # viser greets in a box of its own, and tells of its end.
        with contextlib.redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(host=host, port=port, label="torchgrasp", verbose=False)
        refuse_other_pages(self._server, host)
        self.address = f"http://{host}:{self._server.get_port()}"
        self.scene = ViewerScene(self._server, robot=robot)
        self.panel = ViewerPanel(self._server, policies=policies, speed=speed)
        self._step_seconds, self._target = step_seconds, ""

    @property
    def policy(self) -> str:
        """Name of the policy that the page has chosen."""
        return self.panel.chosen_policy

    def watch(self, policy: TensorDictModuleBase, env: GraspEnv) -> TensorDictModuleBase:
        """The policy, which shows what it sees and plans at each step, and then the closing and the lifting.

        It takes as long as the page's speed says, and raises `Skipped` where the page asks for the next
        episode; the environment can then be reset as ever.

        Args:
            policy: is called with every world; the first one is shown.
            env: the environment, without its transforms.
        """
        env.worlds.watcher = lambda row: self._show_ending(env, row)
        return _Watched(policy, env, self)

    def show(self, state: TensorDictBase, env: GraspEnv) -> None:
        """Draw one world's observation (no batch) and the grasps that a policy wrote beside it."""
        target = env.objects[int(state[keys.OBJECT_ID])]
        T_base_ee = state[keys.T_BASE_EE].double()
        self._target = target.name
        self.scene.show_target(target)
        self.scene.arrange(_array(state[keys.JOINTS]), _array(state[keys.T_BASE_OBJECT]))
        cloud = state.get(keys.POINTS, None)
        points = np.zeros((0, 3)) if cloud is None else observed_points(_array(cloud))
        self.scene.show_cloud(points, _array(T_base_ee))
        for key, colour in _GRASPS.items():
            goal = _goal(state, key)
            pose = None if goal is None else _array(T_base_ee @ goal_to_pose(goal.double()))
            self.scene.show_grasp(key, pose, colour)
        time_left = float(state[keys.TIME_LEFT])
        step = round((1.0 - time_left) * env.horizon)
        self.panel.tell_state(target.name, f"step {step} of {env.horizon}", time_left)

    def show_result(self, policy: str, episode: Episode, table: SuccessTable) -> None:
        """Say how an episode ended and how the policy fares, and let it stand for a second."""
        self.panel.tell_state(episode.object_name, episode.failure or "lifted", 0.0)
        self.panel.tell_success(policy, table)
        with contextlib.suppress(Skipped):
            self.panel.wait(_RESULT)

    def _show_ending(self, env: GraspEnv, row: int) -> None:
        if row == 0:
            self.scene.arrange(env.worlds.joints[0], env.worlds.T_base_object[0])
            self.scene.show_cloud(np.zeros((0, 3)), np.eye(4))  # nothing is observed any longer
            for key, colour in _GRASPS.items():
                self.scene.show_grasp(key, None, colour)
            self.panel.tell_state(self._target, "closing and lifting", 0.0)
            self.panel.wait(self._step_seconds)

    def close(self) -> None:
        """Stop serving the page."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def __enter__(self) -> EpisodeViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Watched(TensorDictModuleBase):
    """A policy that a viewer shows."""

    def __init__(self, policy: TensorDictModuleBase, env: GraspEnv, viewer: EpisodeViewer) -> None:
        super().__init__()
        self.policy, self._env, self._viewer = policy, env, viewer
        self.in_keys, self.out_keys = policy.in_keys, policy.out_keys  # pyright: ignore

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """What the policy does, shown."""
        tensordict = self.policy(tensordict)
        self._viewer.show(tensordict[0], self._env)
        self._viewer.panel.wait(self._viewer._step_seconds)
        return tensordict


def check_viewer_tools() -> None:
    """Raise ConfigError where what serves the page is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f'The viewer needs the extra viz ({error}): pip install "torchgrasp[viz]".'
        ) from error


def _free_port(host: str, port: int) -> int:
    """The port itself, or a free one for 0; viser would go on to the next one without a word."""
    try:
        with socket.create_server((host, port)) as probe:
            return probe.getsockname()[1]
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"host={host} port={port} cannot be listened on ({error}): give another port, or port=0 for any "
            "that is free."
        ) from error


def _goal(state: TensorDictBase, key: str) -> Tensor | None:
    """(7,) goal under a key, None where there is none."""
    goal, has_goal = state.get(key, None), state.get(keys.HAS_GOAL, None)
    if goal is None or (key == keys.GOAL and has_goal is not None and not has_goal.any()):
        return None
    return goal


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().to("cpu", torch.float64).numpy()
