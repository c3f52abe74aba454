"""The numbers that the simulated Panda is built from, whatever engine moves it: links, shapes and drives.

Masses and shapes of the links are franka_ros's.

Finger boxes are exact, because contact decides grasping; every other link is one capsule or box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FINGER_OPEN = 0.04
# A negative target, so that a thin wall between the pads still gets the fingers' whole force.
FINGER_CLOSED = -0.04
FINGER_MOUNT = 0.0584
ARM_STIFFNESS, ARM_DAMPING = 4e3, 2e2
FINGER_STIFFNESS, FINGER_DAMPING = 1e3, 1e2
FINGER_VELOCITY = 0.2
# Inertia of the drive behind each finger, kg. Against 15 g alone, 40 N press the pads millimetres into
# whatever they hold, the deeper the longer a physics step; with it they stand on the surface.
FINGER_ARMATURE = 0.2
# Static and dynamic, of all links but the fingers.
BODY_FRICTION = 0.3


@dataclass(frozen=True)
class Shape:
    """A collision or visual shape in its link's frame.

    Attributes:
        size: (x, y, z) lengths of a box, or (radius, length between the cap centres) of a capsule
            along z.
        position: of its centre, metres.
        roll: about x, radians.
    """

    size: tuple[float, ...]
    position: tuple[float, float, float]
    roll: float = 0.0

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) rotation of the roll."""
        c, s = np.cos(self.roll), np.sin(self.roll)
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) pose of the shape in its link."""
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = self.rotation, self.position
        return frame


@dataclass(frozen=True)
class Inertial:
    """Mass (kg), centre of mass (m) and inertia (kg m2: xx yy zz, xy xz yz) of a link, in its frame."""

    mass: float
    centre: tuple[float, float, float]
    diagonal: tuple[float, float, float]
    products: tuple[float, float, float] = (0.0, 0.0, 0.0)


INERTIALS = (
    Inertial(
        0.629769,
        (-0.041018, -0.00014, 0.049974),
        (0.00315, 0.00388, 0.004285),
        (8.2904e-7, 0.00015, 8.2299e-6),
    ),
    Inertial(
        4.970684,
        (0.003875, 0.002081, -0.04762),
        (0.70337, 0.70661, 0.009117),
        (-0.000139, 0.006772, 0.019169),
    ),
    Inertial(
        0.646926,
        (-0.003141, -0.02872, 0.003495),
        (0.007962, 0.02811, 0.025995),
        (-0.003925, 0.010254, 0.000704),
    ),
    Inertial(
        3.228604,
        (0.027518, 0.039252, -0.066502),
        (0.037242, 0.036155, 0.01083),
        (-0.004761, -0.011396, -0.012805),
    ),
    Inertial(
        3.587895,
        (-0.05317, 0.104419, 0.027454),
        (0.025853, 0.019552, 0.028323),
        (0.007796, -0.001332, 0.008641),
    ),
    Inertial(
        1.225946,
        (-0.011953, 0.041065, -0.038437),
        (0.035549, 0.029474, 0.008627),
        (-0.002117, -0.004037, 0.000229),
    ),
    Inertial(
        1.666555,
        (0.060149, -0.014117, -0.010517),
        (0.001964, 0.004354, 0.005433),
        (0.000109, -0.001158, 0.000341),
    ),
    Inertial(
        0.735522,
        (0.010517, -0.004252, 0.061597),
        (0.012516, 0.010027, 0.004815),
        (-0.000428, -0.001196, -0.000741),
    ),
)
HAND_INERTIAL = Inertial(0.73, (-0.01, 0.0, 0.03), (0.001, 0.0025, 0.0017))
FINGER_INERTIAL = Inertial(0.015, (0.0, 0.0, 0.0), (2.375e-6, 2.375e-6, 7.5e-7))

# One capsule a link, drawn around the arm's published dimensions; links 0 to 7.
ARM_SHAPES = (
    (Shape((0.20, 0.19, 0.14), (-0.04, 0.0, 0.07)),),
    (Shape((0.06, 0.283), (0.0, 0.0, -0.1915)),),
    (Shape((0.06, 0.12), (0.0, 0.0, 0.0)),),
    (Shape((0.06, 0.15), (0.0, 0.0, -0.145)),),
    (Shape((0.06, 0.12), (0.0, 0.0, 0.0)),),
    (Shape((0.06, 0.10), (0.0, 0.0, -0.26)), Shape((0.05, 0.14), (0.0, 0.07, -0.09), 0.4)),
    (Shape((0.05, 0.08), (0.0, 0.0, -0.03)),),
    (Shape((0.04, 0.14), (0.0, 0.0, 0.01)),),
)
HAND_SHAPES = (Shape((0.063, 0.204, 0.092), (0.0, 0.0, 0.02)),)
# Left finger; the right one has y and roll negated.
FINGER_SHAPES = (
    Shape((0.022, 0.015, 0.020), (0.0, 0.0185, 0.011)),
    Shape((0.022, 0.0088, 0.0038), (0.0, 0.0068, 0.0022)),
    Shape((0.0175, 0.007, 0.0235), (0.0, 0.0159, 0.02835), np.pi / 6),
    Shape((0.0175, 0.0152, 0.0185), (0.0, 0.00758, 0.04525)),
)

# Links that share a bit never collide: neighbours, and pairs that the arm's SRDF (franka_ros) rules
# out. What stays on: forearm, wrist and hand against base, shoulder and upper arm.
IGNORE_BITS = {
    "link0": 0b00001, "link1": 0b00001, "link2": 0b01001, "link3": 0b10011, "link4": 0b00111,
    "link5": 0b10100, "link6": 0b11110, "link7": 0b10010, "hand": 0b00010, "finger": 0b00010,
}  # fmt: skip


def mirrored(shape: Shape) -> Shape:
    """The same shape on the other finger."""
    x, y, z = shape.position
    return Shape(shape.size, (x, -y, z), -shape.roll)


def hand_boxes(left: float = FINGER_OPEN, right: float = FINGER_OPEN) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes of hand and fingers: (4, 4) poses in the hand frame and (3,) side lengths, metres.

    Args:
        left: position of the left finger in metres, 0 closed, 0.04 open.
        right: position of the right finger.
    """
    boxes = [(shape.pose, np.array(shape.size)) for shape in HAND_SHAPES]
    for side, opening in ((1.0, left), (-1.0, right)):
        for shape in FINGER_SHAPES:
            shape = shape if side > 0 else mirrored(shape)
            pose = shape.pose
            pose[:3, 3] += (0.0, side * opening, FINGER_MOUNT)
            boxes.append((pose, np.array(shape.size)))
    return boxes
