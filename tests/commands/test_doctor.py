"""The doctor: what it finds here is true, and each cause gets its own remedy."""

import os

import pytest

from torchgrasp.commands import doctor
from torchgrasp.commands.doctor import Check
from torchgrasp.sim import vulkan
from torchgrasp.sim.vulkan import VulkanDevice

SOFTWARE = VulkanDevice("llvmpipe", "software", "llvmpipe Mesa 25.0.7 (LLVM 19)")
OLD = VulkanDevice("llvmpipe", "software", "llvmpipe Mesa 22.3.6 (LLVM 15)")
GPU = VulkanDevice("NVIDIA H100", "GPU", "NVIDIA 550.54.15")


def test_what_the_core_needs_works_here():
    checks = doctor.examine()
    assert not [check for check in checks if check.core and not check.ok]
    names = {check.name for check in checks}
    assert {"python", "torch", "torchrl", "physics", "camera=raycast", "cache", "vulkan", "GPU"} <= names
    assert {f"extra {name}" for name in ("ycb", "random-urdfs", "acronym", "gym", "viz")} <= names


def test_whatever_fails_has_a_remedy():
    assert all(check.remedy for check in doctor.examine() if not check.ok)


@pytest.mark.parametrize(("core", "code"), [(True, 1), (False, 0)])
def test_only_the_core_decides_the_exit_code(monkeypatch, capsys, core, code):
    checks = [Check("a", True, "fine"), Check("b", False, "gone", "bring it back", core=core)]
    monkeypatch.setattr(doctor, "examine", lambda: checks)
    assert doctor.run() == code
    assert "-> bring it back" in capsys.readouterr().out


def test_a_cache_that_cannot_be_written_to_is_told(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no directory")
    monkeypatch.setenv("TORCHGRASP_CACHE", str(tmp_path / "file"))
    check = doctor.check_cache()
    assert not check.ok and "TORCHGRASP_CACHE" in check.remedy
    monkeypatch.setenv("TORCHGRASP_CACHE", str(tmp_path / "new"))
    assert doctor.check_cache().ok and os.listdir(tmp_path / "new" / "objects") == []


@pytest.mark.parametrize(
    ("devices", "error", "nvidia", "told"),
    [
        ([GPU], "", True, None),
        ([SOFTWARE], "", False, None),
        ([OLD], "", False, "Mesa 24.3"),
        ([], "the loader knows no driver", False, "Mesa 24.3"),
        ([], "libvulkan.so.1: cannot open shared object file", False, "libvulkan1"),
        ([], "the loader knows no driver", True, "NVIDIA_DRIVER_CAPABILITIES=all"),
    ],
)
def test_each_cause_has_its_remedy(devices, error, nvidia, told):
    remedy = vulkan.remedy(devices, error, nvidia=nvidia)
    assert remedy == "" if told is None else told in remedy


def test_devices_or_the_reason_why_not():
    devices, error = vulkan.find_devices()
    assert bool(devices) != bool(error)
    assert all(device.name and device.driver for device in devices)


def test_a_package_outside_its_range_is_told_with_the_range():
    from packaging.requirements import Requirement

    check = doctor._check_package(Requirement("numpy>=99"))
    assert not check.ok and ">=99" in check.detail
    assert not doctor._check_package(Requirement("torchgrasp-nowhere>=1")).ok
