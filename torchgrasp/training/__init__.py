"""Learners, what they learn from, and schedules: they take parts, never a configuration.

No simulator is loaded here, and nothing here runs or scores episodes: who does hands them in.
"""

from torchgrasp.training.acceleration import Acceleration as Acceleration
from torchgrasp.training.actor_critic import ActorCriticLearner as ActorCriticLearner
from torchgrasp.training.experience import Experience as Experience
from torchgrasp.training.imitation import ImitationLearner as ImitationLearner
from torchgrasp.training.loss_terms import MeanTerms as MeanTerms
from torchgrasp.training.schedules import cosine_schedule as cosine_schedule
from torchgrasp.training.schedules import linear_schedule as linear_schedule
from torchgrasp.training.schedules import step_schedule as step_schedule
