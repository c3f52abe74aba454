"""The task: a Panda with a wrist camera grasps an object from a table."""

from torchgrasp.envs.grasp import GraspEnv as GraspEnv
from torchgrasp.envs.scene import StartPoses as StartPoses
