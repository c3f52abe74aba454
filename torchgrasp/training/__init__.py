"""Learners, what they learn from, and schedules. They take parts, never a configuration.

No simulator is loaded here: who runs episodes hands them in.
"""

from torchgrasp.training.schedules import cosine_schedule as cosine_schedule
from torchgrasp.training.schedules import linear_schedule as linear_schedule
from torchgrasp.training.schedules import step_schedule as step_schedule
