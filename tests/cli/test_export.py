"""``ia-bench export``: a scene in every format, read back by the command that it prints, and by other programs."""

import shlex
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ia_bench.cli.export import EXAMPLES
from ia_bench.cli.main import main
from ia_bench.common.errors import InputError
from ia_bench.readers.contract import unscored
from ia_bench.readers.writers.calibrated import positions, write_colmap, write_dtu, write_llff
from ia_bench.readers.writers.formats import FORMATS, exposed, exposure
from ia_bench.readers.writers.frames import write_blender, write_native
from ia_bench.readers.writers.parts import mixed
from ia_bench.render.agreement import GOOD, check_agreement
from ia_bench.runs.composition import compose, scene_setting
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.exr import rgbe
from ia_bench.scenes.scene import Scene, View


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", FORMATS)
def test_a_capture_is_written_and_read_back_by_the_printed_command(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "tiny", "its (ü) folder", "--format", name, "capture.views=8"]) == 0
    command = shlex.split(capsys.readouterr().out.splitlines()[-1])
    assert command[:2] == ["ia-bench", "check"]
    config = compose(command[2:])
    scene = read_scene(config.scene, config.reader, truth=True)
    assert len(scene.train) == 8
    out = [f"{name}-clipped", "--format", name, "capture.views=8", "capture.radiometry=ldr", "capture.percentile=80"]
    assert main(["export", "tiny", *out]) == 0
    assert " pixels that are clipped, or not known, are written as they stand" in capsys.readouterr().out
    assert check_agreement(scene, lambda line: None) >= GOOD
    lacking = unscored(scene)
    relit = name in ("native", "tensoir", "nerfactor", "synthetic4relight", "stanford_orb")
    assert (set(lacking) & {"view_synthesis", "albedo", "relighting"} == set()) == relit
    assert name in EXAMPLES


def test_a_capture_without_a_mesh_is_written_without_one(tiny: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    theirs = "theirs, (ü) #1"
    write_blender(Path(theirs), replace(tiny, mesh=None))
    Path("out").mkdir()
    assert main(["export", theirs, "out", "--format", "llff", "reader=nerfstudio", "capture.radiometry=ldr"]) == 0
    assert not Path("out", "mesh.obj").exists()
    for out, says in (("half", "expected a mesh, found none"), (f"{theirs}/out", "expected a place outside of the scene's folder")):
        assert main(["export", theirs, out, "--format", "neilf", "reader=nerfstudio"]) == 2
        assert says in capsys.readouterr().err.splitlines()[-1]
    assert sorted(path.name for path in Path().iterdir()) == ["out", theirs]


@pytest.mark.parametrize(
    ("text", "others", "key"),
    [
        ("tiny", [], "scene"),
        ("./tiny", [], "scene.path"),
        ("tiny", ["reader=nerfstudio"], "scene.path"),
        ("mug", [], "scene.path"),
        ("gone", [], "scene"),
    ],
)
def test_a_shipped_scene_is_meant_where_a_folder_is_called_so(text: str, others: list[str], key: str) -> None:
    for name in ("tiny", "mug"):
        Path(name).mkdir()
    assert scene_setting(text, others) == f"{key}={text}"


def test_photographs_for_a_network_are_written_again_by_the_command_beside_them() -> None:
    """Into a folder that is called as the scene, too."""
    assert (
        main(["export", "tiny", "tiny", "--for", "prior", "--size", "24", "--crop", "--background", "white", "capture.views=2"])
        == 0
    )
    (line,) = [line for line in Path("tiny/README.txt").read_text().splitlines() if line.startswith("  ia-bench export ")]
    *command, out = shlex.split(line)[1:]
    assert (out, main([*command, "again"])) == ("tiny", 0)
    for name in ("images", "masks"):
        first, again = (sorted(path.read_bytes() for path in Path(folder, name).iterdir()) for folder in (out, "again"))
        assert len(first) == 2
        assert first == again


def test_the_command_beside_photographs_for_a_network_names_their_folder_whatever_it_is_called() -> None:
    folder = Path("its (ü) folder")
    assert main(["export", "tiny", str(folder), "--for", "prior", "capture.views=2"]) == 0
    (line,) = [line for line in (folder / "README.txt").read_text().splitlines() if line.startswith("  ia-bench run ")]
    assert compose(shlex.split(line)[2:]).prior.options["path"] == str(folder.resolve())


# ---------------------------------------------------------------- what a format cannot hold
def test_cameras_that_a_format_cannot_hold_are_refused(tiny: Scene, tmp_path: Path) -> None:
    camera = replace(tiny.train[3].camera, centre=(12.0, 16.0))
    shifted = replace(tiny, train=(*tiny.train[:3], replace(tiny.train[3], camera=camera), *tiny.train[4:]))
    for name, write in (("blender-nerf", write_blender), ("llff", write_llff)):
        with pytest.raises(InputError, match=rf"--format {name}: expected views of one focal length .* in view 0003; nerfstudio"):
            write(tmp_path / name, shifted)
    write_dtu(tmp_path / "dtu", shifted)


def test_bright_photographs_are_exposed_and_their_lights_with_them(tiny: Scene) -> None:
    factor = exposure(tiny)
    assert 0.5 < factor < 1
    darker = exposed(tiny, factor)
    pixels = np.concatenate([view.image[view.mask > 0.5].max(-1) for view in darker.train])
    assert (pixels <= 1).mean() == pytest.approx(0.98, abs=0.005)
    np.testing.assert_allclose(darker.truth.lights["night"], factor * tiny.truth.lights["night"])
    recorded = replace(tiny, test=tuple(replace(view, image=3 * view.image, exposure=3.0) for view in tiny.test))
    np.testing.assert_allclose(exposed(recorded, 1.0).test[0].image, tiny.test[0].image, rtol=1e-6)


@pytest.mark.parametrize(
    ("train", "held", "kept", "every"), [(16, 4, 3, 8), (100, 20, 15, 8), (100, 4, 4, 26), (14, 1, 1, 15), (9, 0, 0, 8)]
)
def test_held_out_photographs_stand_where_readers_look_for_them(tiny: Scene, train: int, held: int, kept: int, every: int) -> None:
    def views(split: str, first: int, count: int) -> tuple[View, ...]:
        one, matrices = tiny.train[0], np.tile(tiny.train[0].camera.to_world, (count, 1, 1))
        matrices[:, 0, 3] += first + np.arange(count)
        named = enumerate(replace(one.camera, to_world=matrix) for matrix in matrices)
        return tuple(replace(one, name=f"{split}{number}", camera=camera) for number, camera in named)

    photos, options = mixed(replace(tiny, train=views("train", 0, train), test=views("test", 500, held), novel=()))
    assert (len(photos), options.get("every", 8)) == (train + kept, every)
    assert [photo.name.startswith("test") for photo in photos] == [kept > 0 and place % every == 0 for place in range(len(photos))]


# ---------------------------------------------------------------- read by other programs
def test_trimesh_reads_the_meshes(tiny: Scene, tmp_path: Path) -> None:
    import trimesh

    write_native(tmp_path / "native", tiny)
    write_llff(tmp_path / "llff", tiny)
    for path in (tmp_path / "native" / "mesh.ply", tmp_path / "llff" / "mesh.obj"):
        mesh = trimesh.load(path, process=False)
        assert len(mesh.faces) == len(tiny.mesh.faces)
        np.testing.assert_allclose(mesh.bounds, [tiny.mesh.vertices.min(0), tiny.mesh.vertices.max(0)], atol=1e-6)


def test_pycolmap_reads_the_model(tiny: Scene, tmp_path: Path) -> None:
    """Its cameras see the model's points where ours see the vertices that these are."""
    pycolmap = pytest.importorskip("pycolmap", reason="pip install pycolmap==4.2.1")
    write_colmap(tmp_path, tiny)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    photos, _ = mixed(tiny)
    assert (len(model.images), len(model.points3D), len(model.cameras)) == (len(photos), len(tiny.mesh.vertices), 1)
    image, point = model.images[3], model.points3D[17].xyz
    column, row, _ = photos[2].camera.project(point[None])
    np.testing.assert_allclose(model.cameras[1].img_from_cam(image.cam_from_world() * point), [column[0], row[0]], atol=1e-4)


def test_positions_lie_on_their_rays_as_deep_as_the_renderer_had_them(tiny: Scene) -> None:
    view = tiny.test[0]
    covered = view.mask > 0.99
    column, row, depth = view.camera.project(positions(tiny.mesh, view.camera, covered)[covered].astype(np.float64))
    rows, columns = np.nonzero(covered)
    assert np.median(np.hypot(column - columns - 0.5, row - rows - 0.5)) < 1e-3
    assert np.median(np.abs(depth - view.depth[covered])) < 0.01  # which is a mean over the pixel


def test_a_radiance_picture_by_its_own_formula() -> None:
    picture = rgbe(np.array([[[1.0, 0.5, 0.25], [300, 2, 0]]]))
    assert picture.endswith(b"-Y 1 +X 2\n" + struct.pack("8B", 128, 64, 32, 129, 150, 1, 0, 137))
