"""Transitions and demonstrations: stored compactly, mixed in exact shares, saved without pickle.

Who makes them and who learns from them is not known here. No network and no simulator is loaded.
"""

from torchgrasp.data.buffer import MixtureReplayBuffer as MixtureReplayBuffer
from torchgrasp.data.buffer_memory import estimate_bytes as estimate_bytes
from torchgrasp.data.compact import CompactTransitions as CompactTransitions
from torchgrasp.data.demonstration_card import begin_demonstrations as begin_demonstrations
from torchgrasp.data.demonstration_kinds import find_counted as find_counted
from torchgrasp.data.demonstration_sources import DemonstrationSource as DemonstrationSource
from torchgrasp.data.demonstration_sources import without_expert as without_expert
from torchgrasp.data.demonstrations import Demonstrations as Demonstrations
from torchgrasp.data.demonstrations import drop_damaged_shards as drop_damaged_shards
from torchgrasp.data.demonstrations import open_demonstrations as open_demonstrations
from torchgrasp.data.priorities import Priority as Priority
from torchgrasp.data.sampler import MixtureSampler as MixtureSampler
from torchgrasp.data.shard_storage import ShardStorage as ShardStorage
from torchgrasp.data.shards import append_shard as append_shard
from torchgrasp.data.shards import count_shards as count_shards
from torchgrasp.data.shares import anneal_shares as anneal_shares
from torchgrasp.data.shares import share_batch as share_batch
from torchgrasp.data.shares import split_batch as split_batch
from torchgrasp.data.storage import MixtureStorage as MixtureStorage
from torchgrasp.data.writer import MixtureWriter as MixtureWriter
from torchgrasp.episodes import label_episode_success as label_episode_success
from torchgrasp.episodes import split_episodes as split_episodes
from torchgrasp.episodes import split_tries as split_tries
