"""croissant.json against the properties that the specification of Croissant 1.0 requires, and against the files it describes.

The format's own program, `mlcroissant validate --jsonld datasets/croissant.json`, is no dependency; it had no complaint of the file
that is committed, and it reads all records of it.
"""

import importlib.util
import json
import re
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
DATASETS = ROOT / "datasets"
DATASET = ("@context", "@type", "conformsTo", "description", "license", "name", "url", "creator", "datePublished", "distribution")
RESOURCE = {
    "cr:FileObject": ("@id", "name", "contentUrl", "contentSize", "encodingFormat", "sha256"),
    "cr:FileSet": ("@id", "name", "encodingFormat", "includes"),
}
TYPES = {"sc:Text": str, "sc:Integer": int}
Metadata = dict[str, Any]


def nodes(value: Any) -> Iterator[Metadata]:
    """Every object of the description that defines something, which an ``@id`` alone does not."""
    if isinstance(value, dict):
        if "@type" in value and "@id" in value:
            yield value
        value = [part for key, part in value.items() if key not in ("@context", "data")]
    for part in value if isinstance(value, list) else ():
        yield from nodes(part)


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if set(value) == {"@id"}:
            yield value["@id"]
        value = [part for key, part in value.items() if key not in ("@context", "data")]
    for part in value if isinstance(value, list) else ():
        yield from references(part)


def mistakes(metadata: Metadata) -> list[str]:
    """What the specification requires and the description lacks."""
    found = [f"no {key}" for key in DATASET if not metadata.get(key)]
    if metadata.get("@type") != "sc:Dataset" or metadata.get("conformsTo") != "http://mlcommons.org/croissant/1.0":
        found.append("no data set of Croissant 1.0")
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", metadata.get("datePublished", "")):
        found.append("datePublished is no date")
    if not re.fullmatch(r"\d+\.\d+\.\d+", metadata.get("version", "")):
        found.append("version is not MAJOR.MINOR.PATCH")
    names = [node["@id"] for node in nodes(metadata)]
    found += [f"{name} is defined twice" for name in set(names) if names.count(name) > 1]
    found += [f"{name} is not defined" for name in references(metadata) if name not in names]
    for resource in metadata.get("distribution", []):
        found += [f"{resource['@id']}: no {key}" for key in RESOURCE[resource["@type"]] if not resource.get(key)]
        if not re.fullmatch(r"[0-9a-f]{64}", resource.get("sha256", 64 * "0")):
            found.append(f"{resource['@id']}: sha256 is no SHA-256")
    for records in metadata.get("recordSet", []):
        fields, data = {field["@id"]: field for field in records["field"]}, records.get("data", [])
        found += [f"{name}: no dataType" for name, field in fields.items() if not field.get("dataType")]
        found += [f"{name}: no source" for name, field in fields.items() if not data and not field.get("source")]
        found += [f"{records['@id']}: a record with other fields" for record in data if record.keys() != fields.keys()]
        values = [(name, value) for record in data for name, value in record.items()]
        found += [f"{name}: {value!r}" for name, value in values if not isinstance(value, TYPES[fields[name]["dataType"]])]
    return found


@pytest.fixture(scope="module")
def metadata() -> Metadata:
    return json.loads((DATASETS / "croissant.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def made() -> tuple[str, Metadata]:
    """The manifest and the description of what is there now."""
    spec = importlib.util.spec_from_file_location("croissant", DATASETS / "croissant.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    manifest = module.sums(DATASETS)
    return manifest, module.metadata(DATASETS, manifest)


def test_both_files_are_up_to_date_and_valid_and_have_every_file_in_one_set(metadata: Metadata, made: tuple[str, Metadata]) -> None:
    manifest, described = made
    assert (DATASETS / "sums.sha256").read_text(encoding="utf-8") == manifest, "python datasets/croissant.py writes both again"
    assert metadata == described, "python datasets/croissant.py writes both again"
    assert mistakes(metadata) == []
    files = re.findall(r"^[0-9a-f]{64}  (.+)$", manifest, re.MULTILINE)
    patterns = [resource["includes"] for resource in metadata["distribution"] if "includes" in resource]
    assert len(files) > 1000
    assert not [file for file in files if sum(fnmatch(file, pattern) for pattern in patterns) != 1]
