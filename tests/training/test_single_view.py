import numpy as np
import pytest
import torch
from priors.tiny_network import tiny_weights
from training.test_dataset import shard

from ia_bench.priors.contract import Observations, PriorInfo, Samples
from ia_bench.scores.comparison import scale
from ia_bench_training.shards import ShardInfo, shard_path, write_shard
from ia_bench_training.single_view import main
from ia_bench_training.single_view_scores import Examples, load_examples, score


class Knowing:
    """Returns what it was told, half as bright."""

    info = PriorInfo(frozenset({"albedo", "specular"}))

    def __init__(self, examples):
        self.examples = examples

    def sample(self, observations, *, seed, guidance=None):
        return Samples({"albedo": 0.5 * self.examples.albedo, "specular": self.examples.specular})


def test_scale_is_forgiven_in_albedo_alone(tiny_folder):
    examples = load_examples(str(tiny_folder))
    figures = score(Knowing(examples), examples, samples=8, seed=0)
    assert figures["one sample"] == 100
    assert figures["specular: mean of samples"] == 100
    assert figures["specular: best constant"] < 60


def test_the_image_as_albedo_is_scored_as_by_numpy(tiny_folder):
    examples = load_examples(str(tiny_folder))
    values = []
    for image, truth, mask in zip(examples.shown.images, examples.albedo, examples.shown.masks, strict=True):
        inside = mask.numpy() > 0.5
        predicted, true = image.numpy()[inside], truth.numpy()[inside]
        scaled = predicted * scale("mean_rgb", predicted, true)
        values.append(-10 * np.log10(np.square(scaled - true).mean()))
    empty = [torch.cat([each, torch.zeros_like(each[:1])]) for each in (examples.shown.images, examples.shown.masks)]
    more = [torch.cat([each, each[:1]]) for each in (examples.albedo, examples.specular)]
    for seen in (examples, Examples("one of which shows nothing", Observations(*empty), *more)):
        figures = score(Knowing(seen), seen, samples=1, seed=0)
        assert figures["the image"] == pytest.approx(np.mean(values), abs=1e-3)


def test_the_command_scores_scenes_and_shards(tmp_path, tiny_folder, capsys):
    weights = tiny_weights(tmp_path / "weights")
    (tmp_path / "shards").mkdir()
    write_shard(shard_path(tmp_path / "shards", 0), shard(count=3), ShardInfo(5, 0, 3, 16))
    options = ["--option", f"weights={weights}", "--option", "steps=1", "--samples", "2", "--seeds", "0", "1", "--limit", "2"]
    assert main(["tiny", str(tmp_path / "shards"), *options]) == 0
    header, _, scene, shards = capsys.readouterr().out.strip().splitlines()
    assert header.split(" | ")[2:4] == ["albedo: one grey", "one colour"]
    assert scene.startswith("| diffusion | tiny (2) |")
    assert shards.startswith("| diffusion | shards (2) |")
    assert "±" in shards
    assert not torch.isnan(torch.tensor([float(cell.split()[0]) for cell in shards.split("|")[3:-1]])).any()
