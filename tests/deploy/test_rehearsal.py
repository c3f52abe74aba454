"""The rehearsal's scene: the object as it is told, lying still, and a camera that sees it."""

import dataclasses
import socket
import sys
import threading
import time

import numpy as np
import pytest
from franky_sim.mujoco_simulator import MujocoSimulator

from tests.deploy.stage import CAMERA, drawn, rehearse
from torchgrasp.deploy.rehearsal import Rehearsal, RehearsalCamera
from torchgrasp.deploy.rehearsal_scene import OBJECT, OBJECT_JOINT, Contact, build_scene, object_inertia
from torchgrasp.errors import ConfigError, MissingPackageError, ObjectError
from torchgrasp.sim import Physics


def wait_until(rehearsal, seconds):
    while rehearsal.clock() < seconds:
        time.sleep(0.01)


def test_the_object_has_its_mass_and_damping_and_lies_still():
    target, scene = drawn()
    physics = Physics(mass=0.3)
    with rehearse(physics=physics) as rehearsal:
        model = rehearsal.model
        assert model.body(OBJECT).mass[0] == pytest.approx(0.3)
        spin = object_inertia(target, 0.3)
        assert sorted(model.body(OBJECT).inertia) == pytest.approx(sorted(np.linalg.eigvalsh(spin)), rel=1e-4)
        first = int(model.joint(OBJECT_JOINT).dofadr[0])
        assert model.dof_damping[first : first + 3] == pytest.approx([0.1 * 0.3] * 3)
        wait_until(rehearsal, 0.7)
        moved = rehearsal.now.T_base_object - scene.T_base_object
        assert np.abs(moved[:3, 3]).max() < 2e-3 and np.abs(moved[:3, :3]).max() < 0.02
        assert abs(rehearsal.risen) < 2e-3


def test_a_box_has_the_inertia_of_the_textbook():
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)], dtype=np.float32) / 100

    class Box:
        parts = (corners,)

    expected = 0.12 / 12 * np.diag((0.04**2 + 0.06**2, 0.02**2 + 0.06**2, 0.02**2 + 0.04**2))
    assert np.allclose(object_inertia(Box, 0.12), expected, rtol=1e-5, atol=1e-12)


def test_the_camera_sees_the_object_at_the_time_of_the_rehearsal():
    with rehearse() as rehearsal:
        wait_until(rehearsal, 0.2)
        picture = RehearsalCamera(rehearsal, CAMERA).read()
        assert picture.mask.any() and picture.depth.shape == (112, 112)
        assert 0.0 <= rehearsal.clock() - picture.time < 0.5


def test_coordinates_and_snapshots_agree():
    with rehearse() as rehearsal:
        now = rehearsal.now
        qpos = rehearsal.to_qpos(now)
        assert qpos.shape == (rehearsal.model.nq,) and np.isclose(qpos[:9], now.joints).all()


PORTS = (1337, 1338)  # of libfranka's arm and hand


def listen(host, port):
    server = socket.create_server((host, port))
    server.settimeout(5.0)
    return server


def is_free(host):
    for port in PORTS:
        listen(host, port).close()
    return True


@pytest.mark.parametrize("port", PORTS)
def test_a_port_that_is_taken_is_told_and_nothing_stays_open(port):
    host = "127.83.0.1"
    rehearsal = rehearse(hosts=[host])
    with listen(host, port), pytest.raises(ConfigError, match=f"hosts: none has both ports.*{host}"):
        rehearsal.__enter__()
    assert is_free(host)
    with rehearse(hosts=[host]) as again:
        assert again.host == host
    with listen(host, port), rehearse(hosts=[host, "127.83.0.2"]) as next_one:
        assert next_one.host == "127.83.0.2"


def test_an_object_that_mujoco_refuses_is_told_and_nothing_stays_open():
    target, scene = drawn()
    host, threads = "127.83.0.3", threading.active_count()
    speck = dataclasses.replace(target, parts=tuple(1e-7 * part for part in target.parts))
    rehearsal = Rehearsal(speck, scene.T_base_object, scene.q, hosts=[host])
    with pytest.raises(ObjectError, match=f"{target.name} cannot be rehearsed.*too small") as told:
        rehearsal.__enter__()
    assert "\n" not in str(told.value)
    assert is_free(host) and threading.active_count() == threads
    with pytest.raises(RuntimeError, match="already cleaned up"):
        rehearsal._simulator.cleanup()


def test_a_scene_of_another_franky_sim_is_refused_by_what_it_lacks():
    target, scene = drawn()
    simulator = MujocoSimulator(enable_visualization=False)
    simulator.worldbody.remove(simulator.worldbody.find("geom[@name='ground']"))
    with pytest.raises(ConfigError, match=r"has no geom\[@name='ground'\].*-c constraints.txt"):
        build_scene(simulator, target, scene.T_base_object, Physics(), Contact())


def test_without_franky_sim_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "franky_sim", None)
    with pytest.raises(MissingPackageError, match=r"torchgrasp\[dev\]"):
        rehearse()
