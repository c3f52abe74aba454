"""What the history of a checkout knows of commits: whether code changed since, which is older."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from result_tables import ROOT

from torchgrasp.errors import ConfigError


def run_git(*words: str, root: Path = ROOT) -> str:
    """What a git command prints; ConfigError where it fails."""
    done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True)
    if done.returncode != 0:
        raise ConfigError(f"git {words[0]} failed ({done.stderr.strip()}): results need a whole checkout.")
    return done.stdout.strip()


def has_same_code(commit: str, code: Sequence[str], root: Path = ROOT) -> bool:
    """Whether the present code is that of a commit; not where the commit is unknown here."""
    return _succeeds("diff", "--quiet", commit, "HEAD", "--", *code, root=root)


def find_commit(name: str, root: Path = ROOT) -> str:
    """The commit of this name, or the last one that changed this file or folder; ConfigError: there is none.

    Args:
        name: a commit, or a path below the repository.
        root: the checkout.
    """
    if (root / name).exists():
        if found := run_git("log", "-1", "--format=%h", "--", name, root=root):
            return found
        raise ConfigError(f"No commit holds {name}: name a commit, or a file or folder of the repository.")
    if _succeeds("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}", root=root):
        return run_git("rev-parse", "--short", f"{name}^{{commit}}", root=root)
    raise ConfigError(f"{name} is neither a commit nor a file or folder of the repository.")


def is_in_history(commit: str, of: str = "HEAD", root: Path = ROOT) -> bool:
    """Whether a commit is another one or lies before it; not where it is unknown here."""
    return _succeeds("merge-base", "--is-ancestor", commit, of, root=root)


def _succeeds(*words: str, root: Path) -> bool:
    return subprocess.run(["git", *words], cwd=root, capture_output=True).returncode == 0
