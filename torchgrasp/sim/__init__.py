"""What moves: the Panda, the table and the objects in their physics, and the cameras that look at them.

Only this folder imports sapien and mujoco. TorchRL, rewards and observations are not known here, but in envs.
"""

from torchgrasp.sim._sapien import sapien as sapien
from torchgrasp.sim.appearance import Randomization as Randomization
from torchgrasp.sim.camera import Camera as Camera
from torchgrasp.sim.camera import CameraIntrinsics as CameraIntrinsics
from torchgrasp.sim.camera import LookAt as LookAt
from torchgrasp.sim.camera import View as View
from torchgrasp.sim.camera import look_at as look_at
from torchgrasp.sim.engine import Engine as Engine
from torchgrasp.sim.engines import EngineName as EngineName
from torchgrasp.sim.engines import make_engine as make_engine
from torchgrasp.sim.mujoco.mujoco_engine import MujocoEngine as MujocoEngine
from torchgrasp.sim.physics import Physics as Physics
from torchgrasp.sim.probe import RendererProbe as RendererProbe
from torchgrasp.sim.probe import probe_renderer as probe_renderer
from torchgrasp.sim.raycast import RaycastCamera as RaycastCamera
from torchgrasp.sim.render import RenderCamera as RenderCamera
from torchgrasp.sim.sapien_world import SapienEngine as SapienEngine
from torchgrasp.sim.settle import prepare_resting as prepare_resting
from torchgrasp.sim.settle import settled_poses as settled_poses
from torchgrasp.sim.world import Placement as Placement
from torchgrasp.sim.worlds import Worlds as Worlds
