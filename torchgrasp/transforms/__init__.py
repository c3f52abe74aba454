"""From pictures to the network's input: TorchRL transforms for environments, buffers, bare tensordicts."""

from torchgrasp.transforms.aggregate import AggregatePoints as AggregatePoints
from torchgrasp.transforms.base import PointTransform as PointTransform
from torchgrasp.transforms.depth import DepthToPoints as DepthToPoints
from torchgrasp.transforms.gripper import AppendGripperPoints as AppendGripperPoints
from torchgrasp.transforms.mirror import RandomMirror as RandomMirror
from torchgrasp.transforms.sample import SamplePoints as SamplePoints
