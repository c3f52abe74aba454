"""What trimesh leaves out of binary glTF 2.0: quantised positions, and what it cannot decode."""

from __future__ import annotations

import importlib.util
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from torchgrasp.errors import ObjectError

_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
# Component types of whole numbers: their dtype and the number that stands for 1 where they are normalised.
_NORMALISED = {5120: ("<i1", 127), 5121: ("<u1", 255), 5122: ("<i2", 32767), 5123: ("<u2", 65535)}
_FLOAT = 5126


def prepare_glb(path: Path, data: bytes, *, max_count: int) -> bytes:
    """The file with normalised positions as floats; ObjectError for compression that cannot be decoded.

    Args:
        path: of the file, for messages.
        data: its content.
        max_count: the most elements of one kind that compressed data may announce.
    """
    header, binary = _unpack(data)
    _check_compression(path, header)
    _check_buffers(path, header, len(data), max_count)
    quantised = [index for index in _positions(header) if header["accessors"][index].get("normalized")]
    if not quantised:
        return data
    for index in quantised:
        accessor = header["accessors"][index]
        values = _read_normalised(header, binary, accessor).tobytes()
        header["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(values)})
        binary += values
        fresh = {"bufferView": len(header["bufferViews"]) - 1, "componentType": _FLOAT, "type": "VEC3"}
        header["accessors"][index] = {**fresh, "count": accessor["count"]}
    header["buffers"][0] = {"byteLength": len(binary)}
    return _pack(header, binary)


def _unpack(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON header and the binary chunk of a glb file."""
    magic, version, _, length, kind = struct.unpack_from("<5I", data)
    if magic != _MAGIC or kind != _JSON:
        raise ValueError("no glTF header")
    if version != 2:
        raise ValueError(f"glTF {version} where 2 is read")
    header = json.loads(data[20 : 20 + length])
    if not isinstance(header, dict):
        raise ValueError("the glTF header is no mapping")
    start = 20 + length
    if start + 8 > len(data):
        return header, b""
    length, kind = struct.unpack_from("<2I", data, start)
    return header, data[start + 8 : start + 8 + length] if kind == _BINARY else b""


def _pack(header: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<2I", len(text), _JSON) + text + struct.pack("<2I", len(binary), _BINARY) + binary
    return struct.pack("<3I", _MAGIC, 2, 12 + len(chunks)) + chunks


def _primitives(header: dict[str, Any]) -> list[dict[str, Any]]:
    return [each for mesh in header.get("meshes", []) for each in mesh["primitives"]]


def _positions(header: dict[str, Any]) -> set[int]:
    """The accessors of vertices."""
    return {each["attributes"]["POSITION"] for each in _primitives(header)}


def _check_compression(path: Path, header: dict[str, Any]) -> None:
    draco = [
        each for each in _primitives(header) if "KHR_draco_mesh_compression" in each.get("extensions", {})
    ]
    plain = all("bufferView" in header["accessors"][each["attributes"]["POSITION"]] for each in draco)
    if not plain and importlib.util.find_spec("DracoPy") is None:
        raise ObjectError(
            f"{path} is compressed by Draco: export it without compression, or pip install DracoPy."
        )
    used = {name for view in header.get("bufferViews", []) for name in view.get("extensions", {})}
    if used & {"EXT_meshopt_compression", "KHR_meshopt_compression"}:
        raise ObjectError(f"{path} is compressed by meshopt: export it without compression.")


def _check_buffers(path: Path, header: dict[str, Any], size: int, max_count: int) -> None:
    """Refuse data outside the file, and more elements than it can hold."""
    for buffer in header.get("buffers", []):
        if not buffer.get("uri", "data:").startswith("data:"):
            raise ObjectError(
                f"{path} keeps its data in another file, {buffer['uri']!r}: export it as one .glb file."
            )
    for accessor in header.get("accessors", []):
        most = size if "bufferView" in accessor else max_count  # compressed, or zeros
        if not 0 <= accessor["count"] <= most:
            raise ObjectError(
                f"{path} announces {accessor['count']} elements in {size} bytes: export it again or remove"
                " it."
            )
    for index in _positions(header):
        if "sparse" in header["accessors"][index]:
            raise ObjectError(f"{path} stores sparse vertices, which are not read: export it without them.")


def _read_normalised(header: dict[str, Any], binary: bytes, accessor: dict[str, Any]) -> np.ndarray:
    """(count, 3) float32 vertices of an accessor whose whole numbers stand for [-1, 1] or [0, 1]."""
    view = header["bufferViews"][accessor["bufferView"]]
    dtype, one = _NORMALISED[accessor["componentType"]]
    item = np.dtype(dtype).itemsize
    stored = np.ndarray(
        (accessor["count"], 3),
        dtype,
        binary,
        offset=view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
        strides=(view.get("byteStride", 3 * item), item),
    )
    return np.maximum(stored / np.float32(one), np.float32(-1.0)).astype("<f4")
