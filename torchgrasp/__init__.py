"""torchgrasp: closed-loop 6-DoF grasping from point clouds, as TorchRL components."""

__version__ = "0.1.0"
