"""The task as a TorchRL environment: a Panda with a wrist camera grasps an object from a table or a hand.

Specs, starts, the target's motion and the reward live here. What a network reads is made in transforms,
and who acts is decided elsewhere.
"""

from torchgrasp.envs.grasp import GraspEnv as GraspEnv
from torchgrasp.envs.motion import HandoverTarget as HandoverTarget
from torchgrasp.envs.motion import JitterTarget as JitterTarget
from torchgrasp.envs.motion import MixedTarget as MixedTarget
from torchgrasp.envs.motion import Presentation as Presentation
from torchgrasp.envs.motion import StaticTarget as StaticTarget
from torchgrasp.envs.motion import TargetMotion as TargetMotion
from torchgrasp.envs.starts import Start as Start
from torchgrasp.envs.starts import StartPoses as StartPoses
from torchgrasp.envs.starts import TabletopStart as TabletopStart
