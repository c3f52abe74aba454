"""What cannot be written is told in one line, and what was there stays whole."""

import subprocess
import sys

import pytest

from torchgrasp.data.files import try_folder, write_text_atomically
from torchgrasp.errors import StorageError

# No file may grow beyond 20 kB, as on a disk that is full: the system refuses the rest.
FULL = """
import resource, sys
from pathlib import Path
import torch
from tests.data.rollouts import append, make_episodes, make_rollout
from torchgrasp.data import open_demonstrations, split_episodes
from torchgrasp.errors import StorageError
from torchgrasp.runs import MetricsLogger, load_checkpoint, save_checkpoint, save_weights

folder = Path(sys.argv[1])
small, large = {"w": torch.zeros(9)}, {"w": torch.rand(100_000)}
long = split_episodes(make_rollout(40, 40, generator=torch.Generator().manual_seed(0)))
log = MetricsLogger(folder)
save_checkpoint(folder / "checkpoint", small)
save_weights(folder / "weights.safetensors", {"actor": small}, {})
append(folder / "demos", 0)
log.log(1, {"loss": 0.5})

soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
for name, write in {
    "checkpoint": lambda: save_checkpoint(folder / "checkpoint", large),
    "weights.safetensors": lambda: save_weights(folder / "weights.safetensors", {"actor": large}, {}),
    "shard_00001": lambda: append(folder / "demos", 1, long),
    "metrics.csv": lambda: log.log(2, {"x" * 30_000: 0.25}),
}.items():
    try:
        write()
        print("not refused:", name)
    except StorageError as error:
        told = str(error)
        print(name in told, "File too large" in told, told.endswith("make room there, then go on."))
resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

print(torch.equal(load_checkpoint(folder / "checkpoint")["w"], small["w"]))
print(open_demonstrations(folder / "demos").num_shards, (folder / "metrics.csv").read_text().split())
print(*sorted(path.name for path in (*folder.iterdir(), *(folder / "demos").iterdir())))
append(folder / "demos", 1, long)  # there is room again
print(open_demonstrations(folder / "demos").num_shards)
"""


def test_a_full_disk_is_named_and_harms_nothing(tmp_path):
    command = [sys.executable, "-W", "ignore", "-c", FULL, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout.splitlines() == [
        *4 * ["True True True"],
        "True",
        "1 ['step,loss', '1,0.5']",
        "card.json checkpoint demos metrics.csv shard_00000 weights.safetensors",
        "2",
    ], done.stderr


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("/dev/null/x", r"Not a directory\): a file stands in its way"),
        ("/proc/none/x", r"No such file or directory\): mend that, or give another folder"),
    ],
)
def test_a_folder_that_cannot_be_made_is_named(path, told):
    with pytest.raises(StorageError, match=f"^{path} cannot be written .*{told}"):
        try_folder(path)


def test_a_folder_that_can_be_written_is_left_empty(tmp_path):
    try_folder(tmp_path / "a" / "b")
    assert not list((tmp_path / "a" / "b").iterdir())


def test_a_folder_without_the_right_to_write_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"file.x cannot be written .*a file stands in its way"):
        write_text_atomically(tmp_path / "file" / "x", "text")
