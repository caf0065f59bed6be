"""Our sampler beside the loop of a diffusers pipeline: the same network, steps, batch and start, in the same run.

    python benchmarks/sampling_speed.py [--size 64] [--batch 8] [--steps 10] [--rounds 5]

The network is a small diffusers UNet with random weights that takes the condition by concatenation. The pipeline's loop is
what diffusers pipelines do: the network on the scaled input, DDIMScheduler.step. Both are timed in turn and compared round by
round; the largest difference of the two results is printed as well. A ratio below 1 says that ours is faster. On a CPU the
process's own CPU time is taken, which other programs disturb less than the wall clock.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import torch
from torch import Tensor

from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.sampler import Denoise, NoiseSchedule, SamplerSettings, sample, seeded_noise


def main() -> None:
    """Time both and print the ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("size", 64), ("batch", 8), ("steps", 10), ("rounds", 5)):
        parser.add_argument(f"--{name}", type=int, default=default)
    arguments = parser.parse_args()
    size, batch, steps = arguments.size, arguments.batch, arguments.steps
    import_torchvision()
    from diffusers import DDIMScheduler, UNet2DModel

    torch.manual_seed(0)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    network = UNet2DModel(
        sample_size=size, in_channels=6, out_channels=3, layers_per_block=1, block_out_channels=(32, 64), norm_num_groups=8,
        down_block_types=("DownBlock2D", "DownBlock2D"), up_block_types=("UpBlock2D", "UpBlock2D"),
    ).to(device).eval()  # fmt: skip
    scheduler = DDIMScheduler(prediction_type="sample", clip_sample=False, timestep_spacing="trailing")
    schedule = NoiseSchedule(scheduler.alphas_cumprod)
    condition = torch.rand(batch, 3, size, size, device=device)
    seeds, shape = list(range(batch)), (batch, 3, size, size)

    @torch.no_grad()
    def pipeline() -> Tensor:
        noisy = seeded_noise(seeds, shape[1:])().to(device)
        scheduler.set_timesteps(steps)
        for t in scheduler.timesteps:
            scaled = scheduler.scale_model_input(noisy, t)
            output = network(torch.cat([scaled, condition], 1), t).sample
            noisy = scheduler.step(output, t, noisy).prev_sample
        return noisy

    def make_denoise() -> Denoise:
        def denoise(noisy: Tensor, t: int) -> Tensor:
            estimate: Tensor = network(torch.cat([noisy, condition], 1), t).sample
            return estimate

        return denoise

    def ours() -> Tensor:
        return sample(make_denoise(), schedule, shape, seeds, SamplerSettings(steps, clip=None), device=device)

    clock = time.perf_counter if device == "cuda" else time.process_time
    times: dict[Callable[[], Tensor], list[float]] = {ours: [], pipeline: []}
    results: dict[Callable[[], Tensor], Tensor] = {}
    for _ in range(arguments.rounds + 1):
        for method, seconds in times.items():
            start = clock()
            results[method] = method().cpu()
            seconds.append(clock() - start)
    pairs = list(zip(times[ours][1:], times[pipeline][1:], strict=True))  # the first round warms up
    ratios = sorted(mine / theirs for mine, theirs in pairs)
    mine, theirs = (statistics.median(seconds) for seconds in zip(*pairs, strict=True))
    print(f"{device}, {batch} x {size} x {size}, {steps} steps: ours {mine:.3f} s, diffusers {theirs:.3f} s (medians)")
    print(f"ratio, ours / diffusers: median {statistics.median(ratios):.3f}, from {ratios[0]:.3f} to {ratios[-1]:.3f}")
    print(f"largest difference of the results: {float((results[ours] - results[pipeline]).abs().max()):.1e}")


if __name__ == "__main__":
    main()
