"""The specs of GraspEnv: shapes, types and bounds of everything it reads and writes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torchrl.data import Binary, Bounded, Composite, Unbounded

from torchgrasp import keys
from torchgrasp.sim.camera import Camera


class SpecMaker:
    """Makes specs of one batch shape and device.

    Args:
        batch: the environment's batch size.
        device: of the tensors.
    """

    def __init__(self, batch: torch.Size, device: torch.device | None) -> None:
        self.batch, self.device = batch, device

    def real(self, *shape: int) -> Unbounded:
        """float32 of any size."""
        return Unbounded(self.batch + shape, dtype=torch.float32, device=self.device)

    def count(self) -> Unbounded:
        """One int64."""
        return Unbounded(torch.Size((*self.batch, 1)), dtype=torch.int64, device=self.device)

    def flag(self, *shape: int) -> Binary:
        """Bool."""
        return Binary(shape=self.batch + shape, dtype=torch.bool, device=self.device)

    def share(self) -> Bounded:
        """One float32 in [0, 1]."""
        shape = torch.Size((*self.batch, 1))
        return Bounded(0.0, 1.0, shape=shape, dtype=torch.float32, device=self.device)

    def whole(self, entries: dict) -> Composite:
        """A composite of named specs."""
        return Composite(entries, shape=self.batch, device=self.device)

    def pictures(self, camera: Camera) -> Composite:
        """Depth, mask and whatever else the camera gives."""
        height, width = camera.intrinsics.height, camera.intrinsics.width
        known = {
            "depth": lambda: self.real(height, width),
            "mask": lambda: self.flag(height, width),
            "rgb": lambda: Bounded(
                0,
                255,
                shape=torch.Size((*self.batch, height, width, 3)),
                dtype=torch.uint8,
                device=self.device,
            ),
        }
        return self.whole({channel: known[channel]() for channel in camera.channels})

    def observation(self, cameras: dict[str, Camera]) -> Composite:
        """What reset and step return; `cameras` by the key that holds their pictures."""
        entries: dict = {name: self.pictures(camera) for name, camera in cameras.items()}
        for key in (keys.T_BASE_EE, keys.T_BASE_OBJECT, *(f"T_base_{name}" for name in cameras)):
            entries[key] = self.real(4, 4)
        for key in (keys.OBJECT_ID, keys.WORLD, keys.EPISODE):
            entries[key] = self.count()
        for key in (keys.JOINTS, keys.JOINT_VELOCITIES):
            entries[key] = self.real(9)
        entries[keys.TIME_LEFT] = self.share()
        return self.whole(entries)

    def action(self, bound: Sequence[float]) -> Bounded:
        """Components in [-bound, bound]."""
        high = torch.tensor(bound, dtype=torch.float32, device=self.device).expand(*self.batch, len(bound))
        return Bounded(-high, high, shape=high.shape, dtype=torch.float32, device=self.device)

    def done(self) -> Composite:
        """The three flags of an end."""
        return self.whole({name: self.flag(1) for name in ("done", "terminated", "truncated")})
