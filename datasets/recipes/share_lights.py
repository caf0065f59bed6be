"""Store the lights that several scenes see once, beside their folders.

    python datasets/recipes/share_lights.py datasets/scenes/hat datasets/scenes/ship

What all of the named scenes hold alike moves from their lights/ to the folder `lights` beside that of the scenes, and each
scene.json then names it with its SHA-256. A scene that is rendered anew has lights of its own again.
"""

import argparse
import hashlib
import json
from pathlib import Path
from typing import Any

from scene_folder import write_json


def share(scenes: list[Path]) -> list[Path]:
    """Share the lights of `scenes`, folders beside each other; the files that are newly shared.

    Raises:
        ValueError: if the scenes do not lie beside each other, or if another light of the same name is shared already.
    """
    homes = {scene.resolve().parent.parent / "lights" for scene in scenes}
    if len(homes) > 1:
        raise ValueError(f"expected scenes beside each other, got {', '.join(map(str, scenes))}")
    (home,) = homes
    descriptions = {scene: json.loads((scene / "scene.json").read_text()) for scene in scenes}
    moved: dict[Path, list[Path]] = {}
    for name in descriptions[scenes[0]]["lights"]:
        held = _held(descriptions, name)
        contents = {path.read_bytes() for path in held}
        if len(held) < len(scenes) or len(contents) > 1:
            continue
        shared, content = home / f"{name}.exr", contents.pop()
        if shared.exists() and shared.read_bytes() != content:
            raise ValueError(f"{shared}: expected the light of {scenes[0]}, found another one")
        home.mkdir(exist_ok=True)
        shared.write_bytes(content)
        for description in descriptions.values():
            description["lights"][name] = {"shared": shared.name, "sha256": hashlib.sha256(content).hexdigest()}
        moved[shared] = held
    for scene, description in descriptions.items():
        write_json(scene / "scene.json", description)
    for held in moved.values():  # last, so that a scene has its lights at every moment
        for path in held:
            path.unlink()
    return list(moved)


def _held(descriptions: dict[Path, dict[str, Any]], name: str) -> list[Path]:
    """The files of light `name` in the scenes that hold one of their own."""
    entries = {scene: description["lights"].get(name) for scene, description in descriptions.items()}
    return [scene / entry for scene, entry in entries.items() if isinstance(entry, str)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    for path in share(parser.parse_args().scenes):
        print(path)
