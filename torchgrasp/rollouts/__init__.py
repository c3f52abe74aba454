"""Numbered episodes and who runs them: this process, several, or machines of a Ray cluster.

Nothing here learns or scores: what an episode holds goes to training, evaluation and data.
"""

from torchgrasp.rollouts.episode_pool import Episode as Episode
from torchgrasp.rollouts.episode_pool import EpisodePool as EpisodePool
from torchgrasp.rollouts.episode_pool import SerialPool as SerialPool
from torchgrasp.rollouts.process_pool import ProcessPool as ProcessPool
from torchgrasp.rollouts.ray_pool import RayPool as RayPool
from torchgrasp.rollouts.rounds import collect_rounds as collect_rounds
