"""The policy outside of its simulator: on somebody's camera and arm.

How a policy was trained is not known here, and no training simulator is imported. A rehearsal alone steps a
world: that of a robot's own simulator, over the robot's own protocol.
"""

from torchgrasp.deploy.agent import GraspAgent as GraspAgent
from torchgrasp.deploy.arm import Arm as Arm
from torchgrasp.deploy.closed_loop import ClosedLoop as ClosedLoop
from torchgrasp.deploy.closed_loop import GraspOutcome as GraspOutcome
from torchgrasp.deploy.command import GraspCommand as GraspCommand
from torchgrasp.deploy.depth_camera import DepthCamera as DepthCamera
from torchgrasp.deploy.depth_camera import Picture as Picture
from torchgrasp.deploy.dry_arm import DryArm as DryArm
from torchgrasp.deploy.franka import FrankaArm as FrankaArm
from torchgrasp.deploy.limits import FR3_JOINTS as FR3_JOINTS
from torchgrasp.deploy.limits import PANDA_JOINTS as PANDA_JOINTS
from torchgrasp.deploy.limits import ArmLimits as ArmLimits
