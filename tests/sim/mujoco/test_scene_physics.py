"""Numbers written into a compiled scene against MuJoCo's compiler, to which the same numbers are given."""

import mujoco
import numpy as np
import pytest

from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import MujocoEngine, Physics, Placement
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.mujoco.mujoco_world import MujocoWorld
from torchgrasp.sim.mujoco.scene_model import make_spec
from torchgrasp.sim.mujoco.target_spec import distribute
from torchgrasp.sim.panda_tables import FINGER_VELOCITY

HAND = kin.forward_kinematics(kin.READY_POSTURE[None])[0]
VARIED = Physics(
    vary={
        "mass": (0.05, 0.5),
        "friction": (0.4, 1.2),
        "finger_friction": (0.5, 2.5),
        "finger_force": (10, 70),
    }
)


def make_world(target, physics: Physics, *, held: bool = False) -> MujocoWorld:
    """The object before the fingers."""
    pose = HAND.copy()
    pose[:3, 3] = HAND[:3] @ (0.0, 0.0, 0.11, 1.0)
    world = MujocoEngine().build(Placement(target, pose, kin.READY_POSTURE, physics, held=held))
    assert isinstance(world, MujocoWorld)
    return world


def compile_for(world: MujocoWorld):
    """A model of the world's scene by the compiler alone."""
    placement, contact = world.placement, world._contact
    physics, spread = placement.physics, distribute(placement.target)
    spec = make_spec(placement.target, contact, spread, held=world.held)
    frictions = {0: physics.friction, 1: (0.3 + physics.friction) / 2}
    frictions[2] = (physics.finger_friction + physics.friction) / 2
    for geom in spec.geoms:
        mu = frictions[geom.priority]
        geom.friction = (mu, mu * contact.torsion, mu * contact.rolling)
    for name in ("left_finger", "right_finger"):
        spec.actuator(name).forcerange = (-physics.finger_force, physics.finger_force)
        # A force beyond 80 N is more than the spring of a finger has.
        spec.joint(name).damping = (physics.finger_force / FINGER_VELOCITY, 0.0, 0.0)
    body = spec.body("target")
    body.mass, body.inertia = physics.mass, physics.mass * spread.moments
    model = spec.compile()
    if not world.held:
        turning = physics.angular_damping * model.body("target").inertia
        model.dof_damping[9:] = (*[physics.linear_damping * physics.mass] * 3, *turning)
    return model


def list_numbers(model) -> dict[str, np.ndarray]:
    numbers = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    stat = ("meaninertia", "meanmass", "meansize", "extent", "center")
    numbers |= {f"stat.{name}": np.asarray(getattr(model.stat, name)) for name in stat}
    return {name: each for name, each in numbers.items() if isinstance(each, np.ndarray)}


@pytest.mark.parametrize("held", [False, True])
def test_every_number_is_what_the_compiler_makes_of_it(held):
    objects, rng = ProceduralObjects("train", num_objects=4, num_grasps=100), np.random.default_rng(0)
    for target in [*objects, *objects]:
        world = make_world(target, VARIED.draw(rng), held=held)
        ours, theirs = list_numbers(world._model), list_numbers(compile_for(world))
        assert len(ours) > 200
        assert [name for name in ours if not np.array_equal(ours[name], theirs[name])] == []


def test_an_episode_is_that_of_a_model_compiled_for_it(brick):
    rng = np.random.default_rng(1)
    make_world(brick, VARIED.draw(rng))
    physics = VARIED.draw(rng)
    world, other = make_world(brick, physics), make_world(brick, physics)
    fresh = compile_for(other)
    data = mujoco.MjData(fresh)
    data.qpos[:], data.ctrl[:] = other._data.qpos, other._data.ctrl
    other._model, other._data = fresh, data
    for step in range(5):
        for each in (world, other):
            each.drive(kin.READY_POSTURE + 0.02 * step)
        assert np.array_equal(world._data.qpos, other._data.qpos)
    for each in (world, other):
        each.close_fingers()
        list(each.lift())
    assert np.array_equal(world._data.qpos, other._data.qpos)
    assert np.array_equal(world._data.qvel, other._data.qvel)


def test_no_world_changes_another(brick):
    heavy, light = Physics(mass=0.5, friction=0.4), Physics(mass=0.05, finger_force=10.0)
    alone = make_world(brick, heavy)
    beside, other = make_world(brick, heavy), make_world(brick, light)
    for step in range(3):
        for each in (alone, beside):
            each.drive(kin.READY_POSTURE + 0.02 * step)
        other.drive(kin.READY_POSTURE - 0.05 * step)
        other.close_fingers()
    assert np.array_equal(alone._data.qpos, beside._data.qpos)
    assert beside._model.body("target").mass[0] == 0.5 and other._model.body("target").mass[0] == 0.05
