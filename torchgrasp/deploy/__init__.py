"""The policy outside of its simulator: on somebody's camera and arm.

Nothing here steps a world or imports a simulator; how a policy was trained is not known here.
"""

from torchgrasp.deploy.agent import GraspAgent as GraspAgent
from torchgrasp.deploy.command import GraspCommand as GraspCommand
