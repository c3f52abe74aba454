"""The expert: which grasp to take, and how to get there from any state."""

from torchgrasp.planning.behaviour import Disturb as Disturb
from torchgrasp.planning.behaviour import ExpertStart as ExpertStart
from torchgrasp.planning.behaviour import RandomAction as RandomAction
from torchgrasp.planning.expert import ExpertPolicy as ExpertPolicy
from torchgrasp.planning.funnel import Funnel as Funnel
from torchgrasp.planning.planner import GraspPlanner as GraspPlanner
from torchgrasp.planning.planner import Plan as Plan
from torchgrasp.planning.planner import PlanStatus as PlanStatus
