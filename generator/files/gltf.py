"""glTF files without their looks: of a target only the mesh is taken, so that pictures need not be read."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from generator.model.errors import NlosError

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_KEPT = ("KHR_draco_mesh_compression", "KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "EXT_meshopt_compression")
"""Extensions that say something on the mesh."""


def bare(path: Path, allowed: Path | None) -> tuple[bytes, dict[str, int]]:
    """Return a glTF as one binary file that holds its meshes only, and how many of each thing was left out.

    Parameters
    ----------
    path : Path
    allowed : Path or None
        Folder in which the files that it refers to must lie; None allows any.

    Raises
    ------
    NlosError
        It is no glTF, or a file with its numbers is missing or not allowed.
    """
    try:
        tree, binary = _read(path.read_bytes())
        left_out = _strip(tree)
        for buffer in tree.get("buffers", []):
            if not str(buffer.get("uri", "data:")).startswith("data:"):
                content = _file(path, unquote(buffer["uri"]), allowed)
                buffer["uri"] = f"data:application/octet-stream;base64,{base64.b64encode(content).decode()}"
    except NlosError:
        raise
    except (ValueError, struct.error, AttributeError, TypeError, KeyError, RecursionError):
        raise NlosError(f"target.mesh: {path} is not a glTF file") from None
    return _write(tree, binary), left_out


def _read(data: bytes) -> tuple[dict[str, Any], bytes]:
    if data[:4] != b"glTF":
        return json.loads(data.decode("utf-8-sig")), b""
    chunks: dict[int, bytes] = {}
    at = 12
    while at < len(data):
        size, kind = struct.unpack_from("<II", data, at)
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    return json.loads(chunks[_JSON]), chunks.get(_BINARY, b"")


def _write(tree: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text
    if binary:
        binary += b"\0" * (-len(binary) % 4)
        chunks += struct.pack("<II", len(binary), _BINARY) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _strip(tree: dict[str, Any]) -> dict[str, int]:
    lights = tree.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    counts = {kind: len(tree.pop(f"{kind}s", ())) for kind in ("camera", "material", "animation")}
    counts["light"] = len(lights)
    for name in ("images", "textures", "samplers", "extensions"):
        tree.pop(name, None)
    for node in tree.get("nodes", []):
        node.pop("camera", None)
    for part in [*tree.get("nodes", []), *(p for mesh in tree.get("meshes", []) for p in mesh["primitives"])]:
        part.pop("material", None)
        part["extensions"] = {name: value for name, value in part.get("extensions", {}).items() if name in _KEPT}
    for name in ("extensionsUsed", "extensionsRequired"):
        tree[name] = [
            extension
            for extension in tree.get(name, [])
            if extension in _KEPT or not extension.startswith(("KHR_", "EXT_texture", "EXT_lights"))
        ]
        if not tree[name]:
            del tree[name]
    return counts


def _file(path: Path, name: str, allowed: Path | None) -> bytes:
    file = path.parent / name
    if allowed is not None and not file.resolve().is_relative_to(allowed):
        raise NlosError(
            f"target.mesh: {path} refers to {file}, outside its own folder; copy it there, or allow it with "
            "--trust-links"
        )
    try:
        return file.read_bytes()
    except OSError as error:
        raise NlosError(f"target.mesh: {file}, which {path} refers to, cannot be read ({error.strerror})") from None
