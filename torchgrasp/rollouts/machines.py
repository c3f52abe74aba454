"""What machines must have in common before one runs the other's episodes, and what is said where they differ.

`look` and `look_inside` are sent to the other machine as they stand here, since it may lack this module: they
use the standard library alone.
"""

from __future__ import annotations

import hashlib
import importlib.util
import pickle
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path
from typing import Protocol, runtime_checkable

# What decides an episode, or carries it from one machine to the other.
_PACKAGES = (
    *("torch", "torchrl", "tensordict", "numpy", "scipy", "sapien", "embreex", "frankik", "roma", "trimesh"),
    *("coacd", "manifold3d", "ray"),
)
# Of the code that runs episodes: a wheel holds these two within the package, a checkout beside it.
_BESIDE = ("conf", "recipes")
_NAMED = 3  # differences that are told in full


@runtime_checkable
class Portable(Protocol):
    """A function that makes an environment, and tells what it reads where it does so."""

    def ingredients(self) -> Mapping[str, str]:
        """What it is called -> a digest of what it is; the same wherever the same episodes come out."""
        ...

    def obstacle(self) -> str | None:
        """What keeps this machine from making the environment, None where nothing does."""
        ...


def look(path: list[str]) -> dict[str, str]:
    """Versions of Python, torchgrasp and what decides an episode; what is not installed is left out.

    Args:
        path: where the one who asks finds modules; this machine looks there last.
    """
    sys.path += [each for each in path if each not in sys.path]
    found = {"python": ".".join(platform.python_version_tuple()[:2])}
    for package in _PACKAGES:
        try:
            found[package] = version(package).partition("+")[0]  # a build for CPUs is of the same version
        except PackageNotFoundError:
            continue
    spec = importlib.util.find_spec("torchgrasp")
    if spec is None or spec.origin is None:
        return found
    root, digest = Path(spec.origin).parent, hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        name = file.relative_to(root)
        if name.parts[0] not in _BESIDE:
            digest.update(f"{name.as_posix()} {file.stat().st_size} ".encode() + file.read_bytes())
    lines = Path(spec.origin).read_text().splitlines()
    told = next((line for line in lines if line.startswith("__version__")), "")
    return found | {"torchgrasp": told.partition("=")[2].strip(" \"'"), "code": digest.hexdigest()}


def look_inside(path: list[str], packed: bytes) -> dict[str, dict[str, str]] | str:
    """What each environment is made from on this machine, or what keeps it from being made.

    Args:
        path: as for `look`.
        packed: pickled name -> function that makes an environment.
    """
    sys.path += [each for each in path if each not in sys.path]
    try:
        found = {}
        for name, make in pickle.loads(packed).items():
            if hasattr(make, "ingredients"):
                if (obstacle := make.obstacle()) is not None:
                    return obstacle
                found[name] = dict(make.ingredients())
        return found
    except Exception as error:
        return str(error) or type(error).__name__


def tell_versions(here: Mapping[str, str], there: Mapping[str, str]) -> str | None:
    """How another machine's versions differ from those of this one, None where they do not.

    >>> here = {"python": "3.12", "torch": "2.13.0", "torchgrasp": "0.2.0", "code": "a"}
    >>> tell_versions(here, {**here, "torch": "2.12.1"})
    'torch 2.12.1 in place of 2.13.0'
    >>> tell_versions(here, {**here, "code": "b"})
    'other code of torchgrasp 0.2.0'
    """
    if "torchgrasp" not in there:
        return "no torchgrasp"
    differing = [name for name in here if name != "code" and here[name] != there.get(name)]
    if not differing and here.get("code") != there.get("code"):
        return f"other code of torchgrasp {here['torchgrasp']}"
    lines = [f"{name} {there.get(name, '(none)')} in place of {here[name]}" for name in differing]
    return ", ".join(lines) or None


def tell_ingredients(
    here: Mapping[str, Mapping[str, str]], there: Mapping[str, Mapping[str, str]]
) -> str | None:
    """What another machine would make its environments from that is not what this one has, None if nothing.

    >>> tell_ingredients({"train": {"mug": "a", "bowl": "b"}}, {"train": {"mug": "a", "bowl": "c"}})
    "another bowl for the environment 'train'"
    """
    for env, ours in here.items():
        theirs = there.get(env, {})
        lacking = [name for name in ours if name not in theirs]
        other = [name for name in ours if name in theirs and ours[name] != theirs[name]]
        more = [name for name in theirs if name not in ours]
        for names, how in ((lacking, "no"), (other, "another"), (more, "also")):
            if names:
                rest = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
                return f"{how} {', '.join(islice(names, _NAMED))}{rest} for the environment {env!r}"
    return None
