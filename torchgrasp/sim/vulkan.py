"""Vulkan devices of this machine, asked of the loader itself, and what to do where there is none."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

# Older Mesa lacks VK_KHR_external_semaphore_fd in its software driver, without which SAPIEN finds no device.
OLDEST_MESA = (24, 3)
# Of vulkan_core.h.
_VULKAN_1_1 = 1 << 22 | 1 << 12
_DRIVER_PROPERTIES, _PROPERTIES_2 = 1000196000, 1000059001
_KINDS = ("other", "integrated GPU", "GPU", "virtual GPU", "software")

INSTALL_MESA = (
    "install Mesa 24.3 or newer: apt-get install mesa-vulkan-drivers libvulkan1 (Debian 12: enable its "
    "backports, then apt-get install -t bookworm-backports mesa-vulkan-drivers libvulkan1)"
)
INSTALL_LOADER = "install the loader and a driver: apt-get install libvulkan1 mesa-vulkan-drivers"
INSTALL_NVIDIA = (
    "the NVIDIA driver's graphics part is missing: start the container with "
    "NVIDIA_DRIVER_CAPABILITIES=all, or install libnvidia-gl of the driver's version (cat "
    "/proc/driver/nvidia/version); a GPU split by MIG has no Vulkan: take a whole one, or software: "
    "apt-get install mesa-vulkan-drivers libvulkan1"
)


@dataclass(frozen=True)
class VulkanDevice:
    """One device: its name, what it is, its driver's name and version."""

    name: str
    kind: str
    driver: str

    def __str__(self) -> str:
        return f"{self.name} ({self.kind}, driver {self.driver})"


def find_devices(*, timeout: float = 30.0) -> tuple[list[VulkanDevice], str]:
    """The devices, and why there are none: "" where there are some.

    Asked in a process of its own, because a broken driver ends the one that loads it.
    """
    command = [sys.executable, "-P", __file__]  # the file alone: the package would load PhysX
    try:
        answer = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        return [], f"the driver did not answer within {timeout:.0f} s"
    if answer.returncode:
        lines = answer.stderr.strip().splitlines()
        return [], lines[-1] if lines else f"the driver ended its process (code {answer.returncode})"
    devices = [VulkanDevice(**each) for each in json.loads(answer.stdout)]
    return devices, "" if devices else "the loader knows no driver that finds a device"


def remedy(devices: list[VulkanDevice], error: str, *, nvidia: bool) -> str:
    """What to do about the devices found, "" where they will do; `nvidia`: whether its kernel driver runs."""
    if any(_will_do(device) for device in devices):
        return ""
    if devices:
        return INSTALL_MESA
    if nvidia:
        return INSTALL_NVIDIA
    return INSTALL_LOADER if "libvulkan" in error else INSTALL_MESA


def has_nvidia_driver() -> bool:
    """Whether the kernel runs NVIDIA's driver."""
    return Path("/proc/driver/nvidia/version").exists() or Path("/dev/nvidiactl").exists()


def _will_do(device: VulkanDevice) -> bool:
    mesa = re.search(r"Mesa (\d+)\.(\d+)", device.driver)
    return device.kind != "software" or mesa is None or (int(mesa[1]), int(mesa[2])) >= OLDEST_MESA


def _print_devices() -> None:
    """Write the devices to standard output as JSON; an error message and code 1 where that fails."""
    try:
        print(json.dumps(_enumerate()))
    except OSError as error:
        raise SystemExit(str(error)) from None


def _enumerate() -> list[dict]:
    vk = ctypes.CDLL("libvulkan.so.1")
    instance = ctypes.c_void_p()
    # VkApplicationInfo, which asks for Vulkan 1.1, and VkInstanceCreateInfo, which points to it.
    application = (ctypes.c_uint64 * 6)(0, 0, 0, 0, 0, _VULKAN_1_1 << 32)
    info = (ctypes.c_uint64 * 8)(1, 0, 0, ctypes.addressof(application))
    if code := vk.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)):
        raise OSError(f"the loader finds no driver that works (vkCreateInstance: {code})")
    count = ctypes.c_uint32()
    vk.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    handles = (ctypes.c_void_p * count.value)()
    vk.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
    return [_describe(vk, handle) for handle in handles if handle]


def _describe(vk: ctypes.CDLL, handle: int) -> dict:
    # VkPhysicalDeviceDriverProperties: sType, pNext, driverID, driverName[256], driverInfo[256].
    driver = ctypes.create_string_buffer(1024)
    ctypes.c_uint32.from_buffer(driver).value = _DRIVER_PROPERTIES
    # VkPhysicalDeviceProperties2: sType, pNext, then five numbers, a name and more; 4096 bytes hold all.
    device = ctypes.create_string_buffer(4096)
    ctypes.c_uint32.from_buffer(device).value = _PROPERTIES_2
    ctypes.c_uint64.from_buffer(device, 8).value = ctypes.addressof(driver)
    vk.vkGetPhysicalDeviceProperties2(ctypes.c_void_p(handle), device)
    kind = ctypes.c_uint32.from_buffer(device, 32).value
    return {
        "name": _text(device, 36),
        "kind": _KINDS[kind] if kind < len(_KINDS) else "other",
        "driver": f"{_text(driver, 20)} {_text(driver, 276)}".strip(),
    }


def _text(buffer: ctypes.Array, offset: int) -> str:
    """The text of at most 255 bytes that begins at `offset`."""
    return bytes(buffer[offset : offset + 256]).split(b"\0")[0].decode(errors="replace")


if __name__ == "__main__":
    _print_devices()
