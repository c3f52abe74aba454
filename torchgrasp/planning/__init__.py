"""The expert: which grasp to take, and how to get there from any state.

It reads the world's privileged state, through sim and objects. Nothing learned and no picture comes in here.
"""

from torchgrasp.planning.disturb import Disturb as Disturb
from torchgrasp.planning.expert import ExpertPolicy as ExpertPolicy
from torchgrasp.planning.expert_start import ExpertStart as ExpertStart
from torchgrasp.planning.funnel import Funnel as Funnel
from torchgrasp.planning.funnel_planner import FunnelPlanner as FunnelPlanner
from torchgrasp.planning.goals import GoalChoice as GoalChoice
from torchgrasp.planning.law import Law as Law
from torchgrasp.planning.law import PathFollower as PathFollower
from torchgrasp.planning.open_loop import OpenLoopPolicy as OpenLoopPolicy
from torchgrasp.planning.plan import NO_PLANNER as NO_PLANNER
from torchgrasp.planning.plan import Plan as Plan
from torchgrasp.planning.plan import PlanStatus as PlanStatus
from torchgrasp.planning.planner import Planner as Planner
from torchgrasp.planning.planner import Query as Query
from torchgrasp.planning.pose_noise import PoseNoise as PoseNoise
from torchgrasp.planning.random_action import RandomAction as RandomAction
from torchgrasp.planning.relay import Relay as Relay
from torchgrasp.planning.straight_planner import StraightPlanner as StraightPlanner
from torchgrasp.planning.trajectory import TrajectoryOptimizer as TrajectoryOptimizer
from torchgrasp.planning.trajectory_planner import TrajectoryPlanner as TrajectoryPlanner
