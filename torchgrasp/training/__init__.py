"""What surrounds a training loop: checkpoints, weights, metrics, schedules, run directories."""

from torchgrasp.training.checkpoint import has_checkpoint as has_checkpoint
from torchgrasp.training.checkpoint import load_checkpoint as load_checkpoint
from torchgrasp.training.checkpoint import save_checkpoint as save_checkpoint
from torchgrasp.training.cli import one_line_errors as one_line_errors
from torchgrasp.training.episodes import Episode as Episode
from torchgrasp.training.episodes import EpisodePool as EpisodePool
from torchgrasp.training.episodes import SerialPool as SerialPool
from torchgrasp.training.metrics import MetricsLogger as MetricsLogger
from torchgrasp.training.metrics import SuccessTable as SuccessTable
from torchgrasp.training.metrics import wilson_interval as wilson_interval
from torchgrasp.training.process_pool import ProcessPool as ProcessPool
from torchgrasp.training.progress import Progress as Progress
from torchgrasp.training.ray_pool import RayPool as RayPool
from torchgrasp.training.rounds import collect_rounds as collect_rounds
from torchgrasp.training.run import hardware as hardware
from torchgrasp.training.run import make_run_dir as make_run_dir
from torchgrasp.training.run import versions as versions
from torchgrasp.training.run import write_summary as write_summary
from torchgrasp.training.schedules import cosine_schedule as cosine_schedule
from torchgrasp.training.schedules import linear_schedule as linear_schedule
from torchgrasp.training.schedules import step_schedule as step_schedule
from torchgrasp.training.seeding import get_rng_state as get_rng_state
from torchgrasp.training.seeding import seed_everything as seed_everything
from torchgrasp.training.seeding import set_rng_state as set_rng_state
from torchgrasp.training.weights import load_weights as load_weights
from torchgrasp.training.weights import save_weights as save_weights
