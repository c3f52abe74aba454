"""From pictures to the network's input: TorchRL transforms for environments, buffers and bare tensordicts.

Faults of sensors and goals in hindsight are transforms, too. No network, loss or replay buffer lives here.
"""

from torchgrasp.transforms.aggregate import AggregatePoints as AggregatePoints
from torchgrasp.transforms.base import PointTransform as PointTransform
from torchgrasp.transforms.delay import DelayObservation as DelayObservation
from torchgrasp.transforms.depth import DepthToPoints as DepthToPoints
from torchgrasp.transforms.depth_noise import DepthNoise as DepthNoise
from torchgrasp.transforms.faults import DropPoints as DropPoints
from torchgrasp.transforms.faults import JitterPoints as JitterPoints
from torchgrasp.transforms.gripper_points import AppendGripperPoints as AppendGripperPoints
from torchgrasp.transforms.hindsight import HindsightGoal as HindsightGoal
from torchgrasp.transforms.history import HistoryTransform as HistoryTransform
from torchgrasp.transforms.image import CameraImage as CameraImage
from torchgrasp.transforms.keep_features import KeepFeatures as KeepFeatures
from torchgrasp.transforms.mirror import RandomMirror as RandomMirror
from torchgrasp.transforms.pose_error import CameraPoseError as CameraPoseError
from torchgrasp.transforms.sample import SamplePoints as SamplePoints
from torchgrasp.transforms.table_plane import TablePlane as TablePlane
from torchgrasp.transforms.wrist import WristAngle as WristAngle
