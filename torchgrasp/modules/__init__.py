"""Networks: encoders of point clouds and images, actor and critic heads on them, and exploration.

They read and write the keys of tensordicts. How they are trained is in objectives and training, and no
simulator is loaded.
"""

from torchgrasp.modules.actor import GraspActor as GraspActor
from torchgrasp.modules.critic import GraspCritic as GraspCritic
from torchgrasp.modules.exploration import DecayingUniformNoise as DecayingUniformNoise
from torchgrasp.modules.exploration import ExploringStep as ExploringStep
from torchgrasp.modules.exploration import NearbyActions as NearbyActions
from torchgrasp.modules.goal_predictor import GoalPredictor as GoalPredictor
from torchgrasp.modules.mirrored_policy import MirroredPolicy as MirroredPolicy
from torchgrasp.modules.pointnet import PointNet as PointNet
from torchgrasp.modules.pointnet2 import PointNet2 as PointNet2
from torchgrasp.modules.residual_actor import ACTOR_FEATURE as ACTOR_FEATURE
from torchgrasp.modules.residual_actor import ResidualActor as ResidualActor
from torchgrasp.modules.residual_actor import ResidualPolicy as ResidualPolicy
from torchgrasp.modules.resnet import ResNet18 as ResNet18
from torchgrasp.modules.split import GivenFeature as GivenFeature
from torchgrasp.modules.split import split_network as split_network
from torchgrasp.modules.value_choice import ValueChoice as ValueChoice
