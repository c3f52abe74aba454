"""What is grasped: objects with surfaces, physics parts, grasps and resting poses, and where they come from.

Geometry alone lives here. No engine and no camera: what moves or is seen is in sim.
"""

from torchgrasp.objects.acronym import AcronymObjects as AcronymObjects
from torchgrasp.objects.folder import FolderObjects as FolderObjects
from torchgrasp.objects.mixture import MixtureObjects as MixtureObjects
from torchgrasp.objects.model import GraspObject as GraspObject
from torchgrasp.objects.procedural import ProceduralObjects as ProceduralObjects
from torchgrasp.objects.random_urdfs import RandomUrdfObjects as RandomUrdfObjects
from torchgrasp.objects.sets import ObjectSet as ObjectSet
from torchgrasp.objects.ycb import YcbObjects as YcbObjects
