"""A thousand random shapes that come with PyBullet, zlib licence, extra ``random-urdfs``.

Only data files are read, the simulator is not started. Each object is a union of convex parts, which
serve as they are; inertias in the files are placeholders and are left aside.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects.decomposition import reduce_hull
from torchgrasp.objects.file_objects import Source
from torchgrasp.objects.mesh_files import read_bytes
from torchgrasp.objects.packaged import PackagedObjects, package_folder
from torchgrasp.objects.sets import SPLITS, Split
from torchgrasp.objects.solids import Solid

NUMBERS: dict[Split, range] = {"train": range(800), "val": range(800, 900), "test": range(900, 1000)}


class RandomUrdfObjects(PackagedObjects):
    """Those of PyBullet's random objects that fit the hand, named ``random-000`` to ``random-999``.

    Args:
        split: ``train`` (numbers 0 to 799), ``val`` (800 to 899), ``test`` (900 to 999); None for all.
        num_objects: the first so many; None for all.
        usable_only: leave out what cannot be grasped, as the index in the package says.
        num_grasps: at most so many grasps an object.
        cache_dir: where built objects are kept.
        workers: processes that `prepare` uses.
    """

    def __init__(
        self,
        split: Split | None = None,
        *,
        num_objects: int | None = None,
        usable_only: bool = True,
        num_grasps: int = 400,
        cache_dir: str | Path | None = None,
        workers: int = 1,
    ):
        if split is not None and split not in SPLITS:
            raise ConfigError(f"split={split!r}: give one of {', '.join(SPLITS)}, or None for all objects.")
        folder = package_folder("pybullet_data", "random-urdfs") / "random_urdfs"
        numbers = NUMBERS[split] if split is not None else range(1000)
        super().__init__(
            [
                Source(f"random-{i:03d}", folder / f"{i:03d}" / f"{i:03d}.obj", "random_urdfs", "zlib")
                for i in numbers
            ],
            kind="random_urdfs",
            num_objects=num_objects,
            usable_only=usable_only,
            concavity=0.05,
            num_grasps=num_grasps,
            cache_dir=cache_dir,
            workers=workers,
        )

    def _content(self, source: Source) -> tuple:
        return (*super()._content(source), self._digest(source.file.with_suffix(".urdf")))

    def _solid(self, source: Source) -> Solid:
        return read_parts(source.file, scale=read_scale(source.file.with_suffix(".urdf")))


def read_scale(urdf: Path) -> np.ndarray:
    """(3,) factors to metres, of the collision mesh of a URDF."""
    try:
        mesh = ElementTree.parse(urdf).getroot().find(".//collision/geometry/mesh")
        text = mesh.get("scale", "1 1 1") if mesh is not None else "1 1 1"
        scale = np.array([float(word) for word in text.split()])
    except (ElementTree.ParseError, ValueError, OSError) as error:
        raise ObjectError(f"{urdf} cannot be read ({error}): install pybullet again.") from error
    if scale.shape != (3,) or not (scale > 0).all():
        raise ObjectError(f"{urdf} scales its mesh by {text}: three positive factors are expected.")
    return scale


def read_parts(file: Path, *, scale: np.ndarray) -> Solid:
    """An obj file with one convex part an ``o`` line as a solid.

    Args:
        file: the obj file.
        scale: (3,) factors to metres.
    """
    corners, faces, starts = [], [], []
    for line in read_bytes(file).decode(errors="replace").splitlines():
        kind, *words = line.split() or [""]
        if kind == "o":
            starts.append(len(corners))
        elif kind == "v":
            corners.append([float(word) for word in words[:3]])
        elif kind == "f":
            faces.append([int(word.split("/")[0]) - 1 for word in words])
    vertices = np.array(corners).reshape(-1, 3) * scale
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices)).any(axis=1).sum())
        raise ObjectError(f"{file} has {bad} vertices that are NaN or infinite: the package ships it so.")
    pieces = [reduce_hull(piece) for piece in np.split(vertices, starts[1:])]
    parts = tuple(piece for piece in pieces if piece is not None)
    if not parts:
        raise ObjectError(f"{file} encloses no volume: install pybullet again.")
    return Solid(vertices, np.array(faces, np.int64), parts)
