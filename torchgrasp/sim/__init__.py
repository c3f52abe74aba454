"""What moves: the Panda, the table, the objects and the wrist camera. Only this folder imports sapien."""

from torchgrasp.sim._sapien import sapien as sapien
from torchgrasp.sim.camera import Camera as Camera
from torchgrasp.sim.camera import CameraIntrinsics as CameraIntrinsics
from torchgrasp.sim.camera import View as View
from torchgrasp.sim.physics import Physics as Physics
from torchgrasp.sim.raycast import RaycastCamera as RaycastCamera
from torchgrasp.sim.world import Placement as Placement
from torchgrasp.sim.worlds import Worlds as Worlds
