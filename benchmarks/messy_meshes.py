"""Meshes as scanners, reconstructions and broken downloads leave them, made from a few shapes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

Mesh = trimesh.Trimesh


def make_messy_meshes() -> dict[str, Mesh]:
    """Two dozen meshes by name, in metres, the same at every call."""
    bottle = trimesh.creation.cylinder(0.03, 0.16, sections=48).subdivide().subdivide()
    meshes = {"bottle": bottle, "mug": _mug(), "mug_of_two_bodies": _mug(fused=False)}
    meshes |= {f"shards_{count}": _shards(count) for count in (50, 100, 240, 500, 1000)}
    for name in ("bottle", "mug"):
        fine = _bumpy(meshes[name])
        variants: dict[str, Callable[[Mesh], Mesh]] = {
            "fine": lambda mesh: mesh,
            "soup": _soup,
            "cut": lambda mesh: _keep(mesh, slice(len(mesh.faces) // 2)),
            "holes": lambda mesh: _keep(mesh, np.random.default_rng(0).random(len(mesh.faces)) > 0.02),
            "dust": lambda mesh: _join(mesh, _dust(60)),
            "half_open": lambda mesh: _keep(mesh, mesh.triangles_center[:, 2] < 0.02),
        }
        meshes |= {f"{name}_{kind}": make(fine) for kind, make in variants.items()}
    meshes["pair"] = _join(_box(0.0), _box(0.035))
    meshes["bowl_without_thickness"] = _keep(
        trimesh.creation.icosphere(5, 0.035), lambda mesh: mesh.triangles_center[:, 2] < 0
    )
    meshes["tangle"] = _join(*(_ring(place) for place in range(12)))
    meshes["random_triangles"] = _random_triangles(2000)
    meshes["sheet_rolled_up"] = _roll()
    return meshes


def _join(*meshes: Mesh) -> Mesh:
    """One mesh of several."""
    joined = trimesh.util.concatenate(meshes)
    assert isinstance(joined, Mesh)
    return joined


def _box(x: float) -> Mesh:
    return trimesh.creation.box((0.03, 0.04, 0.1), trimesh.transformations.translation_matrix((x, 0, 0)))


def _mug(*, fused: bool = True) -> Mesh:
    """A cup with a handle that goes into it, or a cup alone."""
    cup = trimesh.creation.revolve(
        [(0, 0), (0.035, 0), (0.035, 0.09), (0.031, 0.09), (0.031, 0.005), (0, 0.005)], sections=64
    )
    cup = cup.subdivide().subdivide()
    cup.apply_translation((0, 0, -0.045))
    if fused:
        return cup
    handle = trimesh.creation.torus(0.025, 0.005)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    handle.apply_translation((0.045, 0, 0))
    return _join(cup, handle)


def _shards(count: int) -> Mesh:
    """Small closed balls that together are a bottle."""
    rng = np.random.default_rng(count)
    points = trimesh.sample.sample_surface(trimesh.creation.cylinder(0.03, 0.16), count, seed=0)[0]
    ball = trimesh.creation.icosphere(1)
    size = 0.006 * np.sqrt(240 / count)
    return _join(
        *(Mesh(ball.vertices * rng.uniform(0.7, 1.2) * size + place, ball.faces) for place in points)
    )


def _bumpy(mesh: Mesh) -> Mesh:
    """Of 200,000 triangles or so, with the noise of a scanner."""
    while len(mesh.faces) < 100_000:
        mesh = mesh.subdivide()
    noise = np.random.default_rng(0).normal(scale=1e-4, size=(len(mesh.vertices), 1))
    return Mesh(mesh.vertices + noise * mesh.vertex_normals, mesh.faces, process=False)


def _keep(mesh: Mesh, which: np.ndarray | slice | Callable[[Mesh], np.ndarray]) -> Mesh:
    chosen = which(mesh) if callable(which) else which
    return Mesh(mesh.vertices, mesh.faces[chosen], process=True)


def _soup(mesh: Mesh) -> Mesh:
    """Its triangles alone, each corner a little off."""
    corners = mesh.triangles.reshape(-1, 3)
    corners = corners + np.random.default_rng(0).normal(scale=2e-5, size=corners.shape)
    return Mesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)


def _dust(count: int) -> Mesh:
    """Open and closed crumbs around the object."""
    rng = np.random.default_rng(0)
    crumbs = [trimesh.creation.icosphere(1, rng.uniform(0.0005, 0.002)) for _ in range(count)]
    for i, crumb in enumerate(crumbs):
        crumb.apply_translation(rng.normal(scale=0.04, size=3))
        if i % 2:
            crumb.update_faces(np.arange(len(crumb.faces)) % 3 > 0)
    return _join(*crumbs)


def _ring(place: int) -> Mesh:
    """A link of a chain."""
    ring = trimesh.creation.torus(0.012, 0.003)
    ring.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2 * (place % 2), (1, 0, 0)))
    ring.apply_translation((0.016 * place, 0, 0))
    return ring


def _random_triangles(count: int) -> Mesh:
    rng = np.random.default_rng(0)
    corners = rng.uniform(-0.03, 0.03, (count, 1, 3)) + rng.normal(scale=0.004, size=(count, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), process=False)


def _roll() -> Mesh:
    """A surface without thickness that winds about itself."""
    turn, along = np.meshgrid(np.linspace(0, 6 * np.pi, 160), np.linspace(-0.05, 0.05, 40))
    radius = 0.01 + 0.02 * turn / (6 * np.pi)
    points = np.stack((radius * np.cos(turn), radius * np.sin(turn), along), -1).reshape(-1, 3)
    corner = (np.arange(39)[:, None] * 160 + np.arange(159)).ravel()
    faces = np.concatenate(
        [
            np.stack((corner, corner + 1, corner + 160), 1),
            np.stack((corner + 1, corner + 161, corner + 160), 1),
        ]
    )
    return Mesh(points, faces, process=False)
