"""suite=preparation: how long mesh files take that come as scanners and reconstructions leave them."""

from __future__ import annotations

import tempfile
import time
import warnings
from pathlib import Path
from statistics import median

from messy_meshes import make_messy_meshes
from omegaconf import DictConfig

from torchgrasp.errors import ObjectError
from torchgrasp.objects import FolderObjects


def benchmark_preparation(cfg: DictConfig) -> dict:
    """Seconds, parts and grasps of each file, then the median and the worst of the seconds."""
    rows = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, mesh in make_messy_meshes().items():
            mesh.export(folder / f"{name}.stl")
            rows[name] = _prepare(folder, name)
            print(f"{name:24} {rows[name]['seconds']:6.1f} s  {rows[name]['told']}", flush=True)
    seconds = [row["seconds"] for row in rows.values()]
    print(f"median {median(seconds):.1f} s, worst {max(seconds):.1f} s of {len(seconds)} files")
    return rows | {"median_seconds": median(seconds), "worst_seconds": max(seconds)}


def _prepare(folder: Path, name: str) -> dict:
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a mesh is open
        try:
            item = FolderObjects(folder, include=[name], cache_dir=folder / "cache")[0]
            told = f"{len(item.parts)} parts, {len(item.grasps)} grasps"
        except ObjectError as error:
            told = str(error)
    return {"seconds": time.perf_counter() - start, "told": told}
