"""Loss modules of the paper, the functions behind them, and target updates.

No optimizer, replay buffer or simulator is known here: a batch comes in, loss terms go out.
"""

from torchgrasp.objectives.goal_aux import GoalAuxLoss as GoalAuxLoss
from torchgrasp.objectives.pose_bc import PoseBCLoss as PoseBCLoss
from torchgrasp.objectives.pose_distances import ActionDistance as ActionDistance
from torchgrasp.objectives.pose_distances import GoalDistance as GoalDistance
from torchgrasp.objectives.pose_distances import PoseDistance as PoseDistance
from torchgrasp.objectives.target_update import StaggeredTargetUpdate as StaggeredTargetUpdate
from torchgrasp.objectives.td3_bc import GraspTD3BCLoss as GraspTD3BCLoss
