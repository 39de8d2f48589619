"""Writes one surface as a binary glTF 2.0 file (specification: registry.khronos.org/glTF)."""

import io
import json
import struct
from typing import Any

import numpy as np
from PIL import Image

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_INT = 5126, 5125


def glb(
    vertices: np.ndarray,
    faces: np.ndarray,
    colour: tuple[float, float, float],
    roughness: float,
    normals: np.ndarray | None = None,
    texture: tuple[Image.Image, np.ndarray] | None = None,
    shades: np.ndarray | None = None,
) -> bytes:
    """A surface of one material as a glTF file.

    Args:
        vertices: (n, 3) [m].
        faces: (m, 3) indices, counter-clockwise seen from outside.
        colour: red, green and blue in linear light, 0 to 1.
        roughness: of the material, 0 (mirror) to 1 (matt).
        normals: (n, 3) unit vectors for smooth shading; without them, faces are flat.
        texture: an image that repeats, and (n, 2) texture coordinates, where 1 is its width or height.
        shades: (n,) factors of the colour at the vertices, 0 to 1.
    """
    arrays = {"POSITION": vertices.astype("<f4")}
    if normals is not None:
        arrays["NORMAL"] = normals.astype("<f4")
    if texture is not None:
        arrays["TEXCOORD_0"] = texture[1].astype("<f4")
    if shades is not None:
        arrays["COLOR_0"] = np.repeat(shades[:, None], 3, axis=1).astype("<f4")
    arrays["indices"] = faces.astype("<u4").reshape(-1)
    parts = [array.tobytes() for array in arrays.values()]
    document = _document(arrays, colour, roughness)
    if texture is not None:
        parts.append(_png(texture[0]))
        document["images"] = [{"bufferView": len(parts) - 1, "mimeType": "image/png"}]
        document["textures"] = [{"source": 0}]
        document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    return _pack(document, parts)


def _document(arrays: dict[str, np.ndarray], colour: tuple[float, float, float], roughness: float) -> dict[str, Any]:
    """The JSON part of the file, without the offsets of its buffers."""
    index = {name: number for number, name in enumerate(arrays)}
    primitive = {"attributes": index, "indices": index.pop("indices"), "material": 0}
    vertices = arrays["POSITION"]
    accessors = [
        {"bufferView": number, "componentType": FLOAT, "count": len(array), "type": f"VEC{array.shape[-1]}"}
        for number, array in enumerate(arrays.values())
    ]
    accessors[-1] |= {"componentType": UNSIGNED_INT, "type": "SCALAR"}
    accessors[0] |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    shading = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": roughness}
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": shading}],
        "accessors": accessors,
    }


def _pack(document: dict[str, Any], parts: list[bytes]) -> bytes:
    """The file: a header, the JSON part and all buffers, each padded to four bytes."""
    sizes = [len(part) for part in parts]
    padded = [part + bytes(-len(part) % 4) for part in parts]
    starts = np.cumsum([0, *(len(part) for part in padded)]).tolist()
    document["bufferViews"] = [
        {"buffer": 0, "byteOffset": start, "byteLength": size} for start, size in zip(starts, sizes, strict=False)
    ]
    binary = b"".join(padded)
    document["buffers"] = [{"byteLength": len(binary)}]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<III", MAGIC, VERSION, 12 + len(chunks)) + chunks


def _png(image: Image.Image) -> bytes:
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()
