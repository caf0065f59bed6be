"""A mistake on a command line is one sentence, told before anything is begun. Those of ``ia-bench run`` are in test_cli.py."""

import importlib.util
import os
import shlex
from pathlib import Path

import pytest
from PIL import Image

from ia_bench.cli.main import main

SUBMITIT = pytest.mark.skipif(importlib.util.find_spec("submitit") is None, reason="needs the extra: pip install -e '.[submitit]'")
ONE_MESH = "expected one mesh (.glb, .gltf, .obj) or folder of pictures, found "
CORES = f"jobs=999999: expected at most {len(os.sched_getaffinity(0))}, the cores that this process may use"
MISTAKES = [
    ("rapport", "unknown command 'rapport'; did you mean 'report'?"),
    ("check", "or prior=NAME; --help lists them"),
    ("check prior=orcale", "unknown prior 'orcale'; did you mean 'oracle'?"),
    ("check prior=oracle scene=hat", "unknown setting of ia-bench check 'scene'"),
    ("check prior=oracle prior.options.noise=-1", "prior.options.noise: expected 0 or more, found -1"),
    ("check prior=[ prior.x", "cannot read"),
    ("check regulariser", "expected regulariser=NAME, found none"),
    ("check regulariser=parsimony regulariser.options.amount=[", "amount: expected"),
    ("check regulariser=parsimony regulariser.options.amount", "amount: expected a number, found None"),
    ("check reader=native prior=none", "unknown setting of ia-bench check 'prior'"),
    ("check reader=nativ", "unknown reader 'nativ'; did you mean 'native'?"),
    ("check reader=native scene.path=nowhere", "no such folder"),
    ("check reader=native reader.options.uv=mash", "unknown value of reader.options.uv: 'mash'; did you mean 'mesh'?"),
    ("check reader=collections:Counter", "expected a class with read"),
    ("decompose disc.png --out out --prior difusion", "did you mean 'diffusion'"),
    ("decompose disc.png --out out --prior oracle", "needs ground truth"),
    ("decompose disc.png --out out --prior none", "provides nothing"),
    ("decompose disc.png --out out --option steps", "cannot read 'prior.options.steps'"),
    ("export tiny out", "expected --format NAME (native, "),
    ("export tiny out --format colmapp", "unknown --format 'colmapp'; did you mean 'colmap'?"),
    ("export tiny --format dtu", "expected SCENE OUT, a scene and a new folder, found tiny"),
    ("export tiny full --format dtu", "full: expected a new folder, or an empty one, found files in it"),
    ("export tinny out --format dtu", "'tinny'; did you mean 'tiny'?"),
    ("export tiny out --for prior --size 4", "--size: expected 8 to 8192 pixels, found 4"),
    ("export tiny out --format dtu --size 64", "--crop: expected them with --for prior, which alone heeds them"),
    ("export tiny out --format dtu capture.views=80", "capture.views=80"),
    ("relight RUN --out x.png", "expected --light; ia-bench relight --help says more"),
    ("relight RUN --light sunst --out x.png", "unknown --light 'sunst'; did you mean 'sunset'? There are: "),
    ("relight RUN --light sunset.hdr --out x.png", "--light=sunset.hdr: no such file"),
    ("run tiny", "tiny: expected SETTING=VALUE, such as scene=tiny"),
    ("run scene.path=RUN/../ceilin", "no such folder; did you mean "),
    ("table paper", "expected SETTING=VALUE, such as table=paper, found 'paper'"),
    ("report . --out out --only", "--only: expected --table NAME beside it, found none"),
    ("report nowhere --out out", "nowhere: expected a folder with runs, found none"),
    ("report . --out out", "expected at least one run's metrics.json, found none"),
    ("report . --out out --table papper", "unknown table 'papper'; did you mean 'paper'?"),
    ("report RUN --out out --reference nobody", "reference: expected one of the rows ceiling, found nobody"),
    ("score --scene tiny seed=3", f"{ONE_MESH}seed=3"),
    ("score RUN/asset.glb", "--scene: expected the scene that it was recovered of"),
    ("score RUN/asset.glb --scene hta", "unknown scene"),
    ("score RUN --scene tiny", "expected results of other software, found a run"),
    ("score RUN/asset.glb b.glb --scene tiny", ONE_MESH),
    ("score gone.glb --scene tiny", "WHAT=gone.glb: no such file"),
    ("score RUN/metrics.json --scene tiny", "expected a mesh (.glb, .gltf, .obj) or a folder of pictures"),
    ("score RUN/asset.glb --scene tiny --up x", "unknown value of --up: 'x'"),
    ("score RUN/asset.glb --scene tiny --light gone.hdr", "--light=gone.hdr: no such file"),
    ("score RUN/asset.glb --scene tiny --light-turn half", "--light-turn: expected a number, found 'half'"),
    ("score RUN/asset.glb --scene tiny --seconds -3", "--seconds: expected 0 or more, found -3"),
    ("score RUN --pictures out --light-turn 9 seed=3", "and OUT, found --light-turn, seed=3"),
    ("table device=cpu table=papper", "unknown table 'papper'; did you mean 'paper'?"),
    ("table device=cpu seeds=0,x", "seeds.1: expected a whole number, found 'x'"),
    ("table device=cpu seeds=1,０", "seeds.1: expected a whole number, found '０'"),
    (f"table device=cpu seeds={'9' * 5000}", "seeds.0: expected "),
    ("table device=cpu jobs=999999", CORES),
    ("table device=cpu scenes=hatt", "unknown scene 'hatt'; did you mean 'hat'?"),
    ("table device=cpu scene.path=/tmp", "it has scenes=, seeds=, rows= and table="),
    ("table device=cpu seeds=0,0", "seeds: expected each once, found 0 more than once"),
    ("table device=cpu seds=1", "unknown setting 'seds'; did you mean 'seeds'?"),
    ("table device=cpu papr", "expected SETTING=VALUE, found 'papr'"),
    ("table device=cpu scenes=hat launcher.attempts=0", "launcher.attempts: expected 1 or more, found 0"),
    ("table device=cpu scenes=hat launcher=slurm", "unknown launcher 'slurm'"),
    ("watch nowhere", "nowhere: expected a folder with runs, found none"),
    ("watch .", "expected the results of a table, which has a cells.json, found none"),
    ("watch . --every 0", "--every: expected 0.2 to 86400 seconds, found 0"),
    ("watch . --every inf", "--every: expected 0.2 to 86400 seconds, found inf"),
]
OF_SLURM = {
    "launcher.cpu=4": "unknown setting 'launcher.cpu'; did you mean 'launcher.cpus'?",
    "launcher.minutes=soon": "launcher.minutes: expected a whole number, found 'soon'",
}
SLURM = "table device=cpu scenes=hat launcher=submitit_slurm"
MISTAKES += [pytest.param(f"{SLURM} {setting}", said, marks=SUBMITIT) for setting, said in OF_SLURM.items()]


@pytest.mark.parametrize(("line", "said"), MISTAKES, ids=lambda text: text[:60])
def test_a_mistake_is_one_sentence(
    line: str, said: str, ceiling: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("full").mkdir()
    Path("full", "file").write_text("")
    Image.new("RGBA", (20, 24), "red").crop((0, 0, 30, 24)).save("disc.png")  # its right third is cut out
    assert main(shlex.split(line.replace("RUN", str(ceiling)))) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert said in err
    assert err.count("\n") == 1, "one line, and no traceback"
    empty = {"out"} if line.startswith("report ") else set[str]()  # which it makes before it reads what is to be reported
    assert {path.name for path in tmp_path.rglob("*")} <= {"disc.png", "full", "file"} | empty, "nothing is written"
