"""`torchgrasp doctor`: what works on this machine, and what to do about what does not.

Only the standard library, and what needs nothing else, is imported here at the top, so that a broken
installation can still be told of.
"""

from __future__ import annotations

import argparse
import importlib
import platform
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import Any

from torchgrasp.names import one_line
from torchgrasp.processes import count_cores

_IMPORTED = (
    "torch",
    "tensordict",
    "torchrl",
    "sapien",
    "embreex.rtcore_scene",
    "frankik",
    "coacd",
    "manifold3d",
    "hydra",
)
_NOT_FOR_USERS = ("dev", "docs")  # extras that work on torchgrasp itself


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        name: of what was looked at.
        ok: whether it works.
        detail: what was found.
        remedy: what to do where it does not work.
        core: whether torchgrasp needs it; the rest widens what it can do.
    """

    name: str
    ok: bool
    detail: str
    remedy: str = ""
    core: bool = True

    def __str__(self) -> str:
        mark = "ok  " if self.ok else "FAIL" if self.core else "--  "
        remedy = f"\n       -> {self.remedy}" if self.remedy and not self.ok else ""
        return f"{mark} {self.name:22s} {self.detail}{remedy}"


HELP = "what works on this machine, and how to mend the rest"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command has no options."""


def run(_: argparse.Namespace | None = None) -> int:
    """Print every check; 0 where all that torchgrasp needs works, else 1."""
    checks = examine()
    print(*checks, sep="\n")
    broken = [check.name for check in checks if check.core and not check.ok]
    print(f"\nBroken: {', '.join(broken)}." if broken else "\nEverything that torchgrasp needs works.")
    return 1 if broken else 0


def examine() -> list[Check]:
    """All checks, in the order in which they are best read."""
    return [
        *check_versions(),
        *check_imports(),
        check_physics(),
        check_rays(),
        check_cache(),
        check_cores(),
        check_vulkan(),
        check_renderer(),
        check_cuda(),
        *check_extras(),
    ]


def check_versions() -> list[Check]:
    """Python and every required package against the ranges of the installed torchgrasp."""
    python, needed = platform.python_version(), "3.11 to 3.13"
    fits = (3, 11) <= tuple(map(int, platform.python_version_tuple()[:2])) <= (3, 13)
    checks = [Check("python", fits, python, f"make an environment with Python {needed}")]
    try:
        wanted = [each for each in _requirements() if _applies(each)]
    except PackageNotFoundError:
        return [*checks, Check("torchgrasp", False, "not installed", "pip install -c constraints.txt -e .")]
    return checks + [_check_package(each) for each in wanted]


def check_extras() -> list[Check]:
    """Each extra of torchgrasp, and the command that installs it."""
    try:
        wanted, provided = _requirements(), metadata("torchgrasp").get_all("Provides-Extra") or ()
    except PackageNotFoundError:
        return []  # check_versions has said that torchgrasp is not installed
    groups: dict[str, list[Check]] = {}
    extras = sorted({*provided} - {*_NOT_FOR_USERS})
    for each in wanted:
        for extra in extras:
            if not each.extras and not _applies(each) and _applies(each, extra):
                groups.setdefault(extra, []).append(_check_package(each))
    return [
        Check(
            f"extra {extra}",
            all(check.ok for check in found),
            ", ".join(f"{check.name} {check.detail}" for check in found),
            f'pip install "torchgrasp[{extra}]"',
            core=False,
        )
        for extra, found in groups.items()
    ]


def _requirements() -> list[Any]:
    from packaging.requirements import Requirement

    return [Requirement(line) for line in requires("torchgrasp") or ()]


def _applies(wanted: Any, extra: str = "") -> bool:
    """Whether a requirement holds on this machine, for the extra or without one."""
    return wanted.marker is None or wanted.marker.evaluate({"extra": extra})


def _spared() -> set[str]:
    """Packages that are required on other machines and not on this one, which has no wheels of them."""
    try:
        wanted = _requirements()
    except PackageNotFoundError:
        return set()
    return {each.name for each in wanted if not _applies(each) and "extra" not in str(each.marker)}


def _check_package(wanted: Any) -> Check:
    try:
        found = version(wanted.name)
    except PackageNotFoundError:
        return Check(wanted.name, False, "not installed", f'pip install "{wanted.name}{wanted.specifier}"')
    remedy = f'torch, torchrl and tensordict move together: pip install -c constraints.txt "{wanted.name}"'
    fits = wanted.specifier.contains(found, prereleases=True)
    return Check(wanted.name, fits, found if fits else f"{found}, but {wanted.specifier} is needed", remedy)


def check_imports() -> list[Check]:
    """Compiled packages that are installed and yet do not load; nothing where all do."""
    failed, spared = [], _spared()
    for name in _IMPORTED:
        package = name.split(".")[0]
        if package in spared:
            continue
        try:
            importlib.import_module(name)
        except Exception as error:  # a library that does not load raises whatever it likes
            remedy = f"pip install --force-reinstall -c constraints.txt {package}"
            failed.append(Check(f"import {package}", False, _one_line(error), remedy))
    return failed


def _attempt(name: str, action: Callable[[], str], remedy: str, *, core: bool = True) -> Check:
    """A check that passes with what the action tells, or fails with its error."""
    try:
        return Check(name, True, action(), core=core)
    except Exception as error:  # whatever goes wrong is the finding
        return Check(name, False, _one_line(error), remedy, core=core)


def check_physics() -> Check:
    """Whether PhysX steps a scene with the robot in it."""

    def step() -> str:
        from torchgrasp.sim import sapien
        from torchgrasp.sim.panda import Panda

        system = sapien.physx.PhysxCpuSystem()
        Panda(sapien.Scene([system]))
        system.step()
        return "PhysX steps a scene on the CPU"

    return _attempt("physics", step, "pip install --force-reinstall sapien", core="sapien" not in _spared())


def check_rays() -> Check:
    """Whether Embree casts a ray: camera=raycast."""

    def cast() -> str:
        import numpy as np
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene()
        corners = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], dtype=np.float32)
        mesh = TriangleMesh(scene, corners, np.array([[0, 1, 2]], dtype=np.int32))
        origin, along = np.array([[0.2, 0.2, 0]], np.float32), np.array([[0, 0, 1]], np.float32)
        distance = float(scene.run(origin, along, query="DISTANCE")[0])
        del mesh
        if abs(distance - 1.0) > 1e-5:
            raise RuntimeError(f"a ray of 1 m came back as {distance} m")
        return "a ray hits where it should"

    remedy = "pip install --force-reinstall embreex"
    return _attempt("camera=raycast", cast, remedy, core="embreex" not in _spared())


def check_cache() -> Check:
    """Whether prepared objects can be kept."""

    def write() -> str:
        from torchgrasp.objects.cache import default_cache_dir

        folder = default_cache_dir()
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return str(folder)

    return _attempt("cache", write, "set TORCHGRASP_CACHE to a directory that can be written to")


def check_cores() -> Check:
    """How many processes are worth starting."""
    return Check("cores", True, f"{count_cores()} usable: collector.num_workers up to that many")


def check_vulkan() -> Check:
    """Vulkan devices, and the remedy that fits where there is none that will do."""
    try:
        from torchgrasp.sim import vulkan
    except Exception as error:  # SAPIEN does not load: its own check tells the remedy
        return Check("vulkan", False, _one_line(error), "mend what is broken above first", core=False)
    devices, error = vulkan.find_devices()
    mend = vulkan.remedy(devices, error, nvidia=vulkan.has_nvidia_driver())
    return Check("vulkan", not mend, error or "; ".join(map(str, devices)), mend, core=False)


def check_renderer() -> Check:
    """Whether SAPIEN renders: camera=render."""

    def probe() -> str:
        from torchgrasp.sim import probe_renderer

        found = probe_renderer()
        if not found.ok:
            raise RuntimeError(found.error)
        return str(found.device)

    return _attempt("camera=render", probe, "mend vulkan, above; camera=raycast does without", core=False)


def check_cuda() -> Check:
    """GPUs that torch can use."""

    def name() -> str:
        import torch

        if not torch.cuda.is_available():
            raise RuntimeError("torch sees none")
        return ", ".join(torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count()))

    remedy = "nothing needs one; to use one, install torch's CUDA build and NVIDIA's driver"
    if Path("/proc/driver/nvidia/version").exists():
        remedy = "the NVIDIA driver runs: install torch's CUDA build (device=cuda)"
    return _attempt("GPU", name, remedy, core=False)


def _one_line(error: BaseException) -> str:
    return one_line(f"{type(error).__name__}: {error}")[:300]
