"""The parts of a glTF 2.0 file, .gltf or .glb: its tree, the extensions that it needs, and its buffers."""

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ablate.setting import shown

#: Extensions that are read (the first), and that move no vertex. One that is required, or that stands at a part of the
#: surface, is among them: a reader that passes over another one has another surface.
_KNOWN = """
KHR_mesh_quantization
KHR_animation_pointer KHR_lights_punctual KHR_texture_basisu KHR_texture_transform KHR_xmp KHR_xmp_json_ld
KHR_materials_anisotropy KHR_materials_clearcoat KHR_materials_common KHR_materials_diffuse_transmission
KHR_materials_dispersion KHR_materials_emissive_strength KHR_materials_ior KHR_materials_iridescence
KHR_materials_pbrSpecularGlossiness KHR_materials_sheen KHR_materials_specular KHR_materials_transmission
KHR_materials_unlit KHR_materials_variants KHR_materials_volume KHR_materials_volume_scatter
EXT_lights_ies EXT_lights_image_based EXT_mesh_features EXT_structural_metadata EXT_texture_avif EXT_texture_webp
CESIUM_primitive_outline FB_ngon_encoding MSFT_lod MSFT_texture_dds
"""
EXTENSIONS = frozenset(_KNOWN.split())
#: Compressions, which leave the plain data beside them where they are not required.
COMPRESSIONS = frozenset({"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"})
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


@dataclass(frozen=True)
class Document:
    """A glTF file: where it is, its tree, and the buffer that lies in a .glb."""

    path: Path
    tree: dict[str, Any]
    binary: bytes | None = None

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """One of the accessors, meshes, nodes and so on; a ValueError where it is not there or holds what is not read.

        What is not read are extensions at it that are not in `EXTENSIONS`.
        """
        entries = self.tree.get(kind, [])
        if type(index) is not int or not 0 <= index < len(entries):
            raise ValueError(f"{kind} {shown(index)} is not among its {len(entries)} {kind}")
        check_extensions(entries[index], f"{kind} {index}")
        entry: dict[str, Any] = entries[index]
        return entry


def gltf_document(path: Path) -> Document:
    """Read the tree of a file, and of a .glb its buffer, too.

    Raises ValueError where it is no glTF 2.0, a .glb is not as long as it declares, or it requires an extension that is
    not read.
    """
    content, binary = path.read_bytes(), None
    if content[:4] == b"glTF":
        content, binary = _chunks(content)
    tree = json.loads(content.decode("utf-8-sig"))
    if not isinstance(tree, dict):
        raise ValueError("its JSON is no mapping")
    asset = tree.get("asset") or {}
    version = asset.get("minVersion", asset.get("version"))
    if str(version) != "2.0":
        raise ValueError(f"asset.version={shown(version)}: allowed is 2.0")
    if unknown := sorted({*tree.get("extensionsRequired", [])} - EXTENSIONS):
        raise ValueError(f"it requires {', '.join(map(shown, unknown))}, which is not read; export it without")
    return Document(path, tree, binary)


def _chunks(content: bytes) -> tuple[bytes, bytes | None]:
    """The JSON of a .glb and its buffer, if it has one; other chunks are passed over, as the format allows."""
    if len(content) < 20:
        raise ValueError("it ends in its header")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise ValueError(f"it has version {version} of glTF; allowed is 2")
    if length != len(content):
        raise ValueError(f"its header declares {length} bytes, {len(content)} are there")
    place, chunks = 12, dict[int, bytes]()
    while place + 8 <= length:
        size, kind = struct.unpack_from("<II", content, place)
        if place + 8 + size > length:
            raise ValueError(f"a chunk in it declares {size} bytes, {length - place - 8} are left")
        chunks.setdefault(kind, content[place + 8 : place + 8 + size])
        place += 8 + size
    if place != length or _JSON not in chunks:
        raise ValueError("its chunks do not fill it" if place != length else "it has no chunk of JSON")
    return chunks[_JSON], chunks.get(_BINARY)


def check_extensions(entry: dict[str, Any], where: str) -> None:
    """Raise ValueError where an extension that is not read stands at a part of the surface."""
    if unknown := sorted({*entry.get("extensions", {})} - EXTENSIONS - COMPRESSIONS):
        raise ValueError(f"{where} has {', '.join(map(shown, unknown))}, which is not read; export it without")


def buffer_files(document: Document) -> list[Path | None]:
    """The file of each buffer, None where it lies in the document."""
    uris = [buffer.get("uri", "data:") for buffer in document.tree.get("buffers", [])]
    return [None if uri.startswith("data:") else _file_of(document.path.parent, uri) for uri in uris]


def _file_of(folder: Path, uri: str) -> Path:
    """A file that is named by a URI, in which a blank is %20, or by its plain name."""
    return folder / unquote(uri) if (folder / unquote(uri)).is_file() else folder / uri


def buffer_bytes(document: Document, index: Any) -> bytes:
    """A buffer; a ValueError where it is shorter than it declares."""
    buffer = document.entry("buffers", index)
    file, uri = buffer_files(document)[index], buffer.get("uri")
    if file is not None:
        content = file.read_bytes()
    elif uri is None and index == 0 and document.binary is not None:
        content = document.binary
    elif uri is not None and (data := uri.partition(";base64,"))[1]:
        content = base64.b64decode(unquote(data[2]), validate=True)
    else:
        packed = ", ".join(sorted({*buffer.get("extensions", {})}))
        raise ValueError(f"buffers {index} holds no data{packed and f'; it is in {packed}, which is not read'}")
    if len(content) < buffer["byteLength"]:
        raise ValueError(f"buffers {index} declares {buffer['byteLength']} bytes, {len(content)} are there")
    return content
