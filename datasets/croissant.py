"""Write what describes the shipped scenes to programs, croissant.json and sums.sha256, both beside this file.

    python datasets/croissant.py

croissant.json is metadata in the Croissant format 1.0 (https://docs.mlcommons.org/croissant/docs/croissant-spec.html): what the
files are, with licence and citation, and records of the scenes and of their cameras. sums.sha256 has the SHA-256 of every file, and
croissant.json that of sums.sha256.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).resolve().parent
SUMS, METADATA = "sums.sha256", "croissant.json"
LICENCE = "https://creativecommons.org/licenses/by/4.0/"
DESCRIPTION = (
    "Rendered photographs of five objects, each under one light, with what inverse rendering is to recover of them: albedo, "
    "roughness, specular shading, the light, and views under lights that no training image shows. All were modelled in code and "
    "rendered by Blender's Cycles."
)
KEYWORDS = ["inverse rendering", "intrinsic images", "material estimation", "relighting", "albedo", "benchmark"]
SETS = {
    "descriptions": ("scenes/*/scene.json", "application/json", "conventions, splits, lights, and how the scene was rendered"),
    "cameras": ("scenes/*/transforms_*.json", "application/json", "the cameras of a split, and the files of each view"),
    "meshes": ("scenes/*/mesh.ply", "application/ply", "the object, with texture coordinates and shading normals"),
    "textures": ("scenes/*/truth/*.png", "image/png", "true roughness, 8-bit linear, and the albedo of tiny, 8-bit sRGB"),
    "albedo-textures": ("scenes/*/truth/*.webp", "image/webp", "true albedo, 8-bit sRGB, lossless"),
    "photographs": ("scenes/*/images/*.exr", "image/x-exr", "RGBA, linear Rec.709, premultiplied by the coverage"),
    "truth": ("scenes/*/truth/*.exr", "image/x-exr", "of views: albedo, specular shading, roughness, depth, normals"),
    "direct": ("scenes/*/direct/*.exr", "image/x-exr", "test views without interreflection"),
    "lights": ("*lights/*.exr", "image/x-exr", "lat-long environment maps, linear Rec.709"),
}
"""Name of a set of files: pattern (of Python's fnmatch, from this folder), type, and what they are."""

SAME = """citeAs column equivalentProperty extract field fileProperty fileObject fileSet format includes isLiveDataset jsonPath key
md5 parentField path recordSet references regex repeated replace samplingRate separator source subField transform"""
CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    **{name: f"cr:{name}" for name in SAME.split()},
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
}
"""The terms of the format, of which its appendix 1 and its programs ask for all."""


def sums(folder: Path) -> str:
    """The manifest: a line for every file below scenes and lights, as ``sha256sum`` writes and checks it."""
    files = sorted(path for part in ("lights", "scenes") for path in (folder / part).rglob("*") if path.is_file())
    return "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}\n" for path in files)


def metadata(folder: Path, manifest: str) -> dict[str, Any]:
    """The description of the scenes in ``folder`` whose manifest has this text."""
    citation = yaml.safe_load((folder.parent / "CITATION.cff").read_text(encoding="utf-8"))
    authors = [author["name"] for author in citation["authors"]]
    date, version = str(citation["date-released"]), citation["version"]
    said = {
        "author": " and ".join(f"{{{name}}}" for name in authors),
        "title": citation["title"],
        "year": date[:4],
        "note": f"Version {version}",
    }
    listed = {
        "@type": "cr:FileObject",
        "@id": SUMS,
        "name": SUMS,
        "description": "The SHA-256 of every file",
        "contentUrl": SUMS,
        "contentSize": f"{len(manifest)} B",
        "encodingFormat": "text/plain",
        "sha256": hashlib.sha256(manifest.encode()).hexdigest(),
    }
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": "ia_bench_scenes",
        "description": DESCRIPTION,
        "url": "README.md",  # beside the file, until the project has an address
        "license": LICENCE,
        "creator": [{"@type": "sc:Organization", "name": name} for name in authors],
        "citeAs": "@misc{ia_bench, " + ", ".join(f"{key} = {{{value}}}" for key, value in said.items()) + "}",
        "datePublished": date,
        "version": version,
        "keywords": KEYWORDS,
        "isLiveDataset": False,
        "distribution": [listed, *(_set(name, *SETS[name]) for name in SETS)],
        "recordSet": [_scenes(folder), _views()],
    }


def _set(name: str, pattern: str, kind: str, about: str) -> dict[str, Any]:
    return {"@type": "cr:FileSet", "@id": name, "name": name, "description": about, "encodingFormat": kind, "includes": pattern}


def _scenes(folder: Path) -> dict[str, Any]:
    """One record a scene, with the record itself."""
    records = []
    for path in sorted(folder.glob("scenes/*/scene.json")):
        scene = json.loads(path.read_text(encoding="utf-8"))
        views = {f"scenes/{split}": count for split, count in scene["splits"].items()}
        records.append({"scenes/name": path.parent.name, "scenes/pixels": scene["render"]["size"], **views})
    fields = {
        "name": ("sc:Text", "Folder below scenes"),
        "pixels": ("sc:Integer", "Width and height of a view"),
        "train": ("sc:Integer", "Training views"),
        "test": ("sc:Integer", "Test views, under the training light"),
        "novel": ("sc:Integer", "Novel cameras, each of which sees the object under every light"),
    }
    listed = [_field("scenes", name, kind, about) for name, (kind, about) in fields.items()]
    return {**_records("scenes", listed), "key": {"@id": "scenes/name"}, "data": records}


def _views() -> dict[str, Any]:
    """One record a view, read from the files of cameras."""
    scene = {"extract": {"fileProperty": "fullpath"}, "transform": {"regex": "scenes/([^/]+)/"}}
    fields = {
        "scene": ("sc:Text", "Folder below scenes", scene),
        "file": ("sc:Text", "The view's photograph, from the scene's folder", _json("file_path")),
        "camera_to_world": ("sc:Float", "4 x 4; the camera looks along -z, +y is up", _json("transform_matrix")),
    }
    cameras = {"fileSet": {"@id": "cameras"}}
    listed = [_field("views", name, kind, about) | {"source": cameras | how} for name, (kind, about, how) in fields.items()]
    return _records("views", listed)


def _json(key: str) -> dict[str, Any]:
    return {"extract": {"jsonPath": f"$.frames[*].{key}"}}


def _records(name: str, fields: list[dict[str, Any]]) -> dict[str, Any]:
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "field": fields}


def _field(records: str, name: str, kind: str, about: str) -> dict[str, Any]:
    return {"@type": "cr:Field", "@id": f"{records}/{name}", "name": name, "description": about, "dataType": kind}


def main(folder: Path = HERE) -> None:
    """Write both files into ``folder``."""
    manifest = sums(folder)
    (folder / SUMS).write_text(manifest, encoding="utf-8")
    (folder / METADATA).write_text(json.dumps(metadata(folder, manifest), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
