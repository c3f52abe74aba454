"""What is grasped: objects with surfaces, physics parts, grasps and resting poses."""

from torchgrasp.objects.acronym import AcronymObjects as AcronymObjects
from torchgrasp.objects.folder import FolderObjects as FolderObjects
from torchgrasp.objects.mixture import MixtureObjects as MixtureObjects
from torchgrasp.objects.model import GraspObject as GraspObject
from torchgrasp.objects.procedural import ProceduralObjects as ProceduralObjects
from torchgrasp.objects.random_urdfs import RandomUrdfObjects as RandomUrdfObjects
from torchgrasp.objects.sets import ObjectSet as ObjectSet
from torchgrasp.objects.ycb import YcbObjects as YcbObjects
