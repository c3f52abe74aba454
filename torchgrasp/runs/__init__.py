"""What a run leaves on disk: directory, checkpoint, weights, metrics, summary; and its seeds and progress.

No simulator and no Hydra is loaded here, and nothing here knows what is trained.
"""

from torchgrasp.runs.checkpoint import load_checkpoint as load_checkpoint
from torchgrasp.runs.checkpoint import save_checkpoint as save_checkpoint
from torchgrasp.runs.metrics import MetricsLogger as MetricsLogger
from torchgrasp.runs.progress import Progress as Progress
from torchgrasp.runs.run_directory import hardware as hardware
from torchgrasp.runs.run_directory import make_run_dir as make_run_dir
from torchgrasp.runs.run_directory import write_summary as write_summary
from torchgrasp.runs.seeding import get_rng_state as get_rng_state
from torchgrasp.runs.seeding import seed_everything as seed_everything
from torchgrasp.runs.seeding import set_rng_state as set_rng_state
from torchgrasp.runs.stopwatch import Stopwatch as Stopwatch
from torchgrasp.runs.weights import PRETRAINED as PRETRAINED
from torchgrasp.runs.weights import load_weights as load_weights
from torchgrasp.runs.weights import save_weights as save_weights
from torchgrasp.versions import versions as versions
