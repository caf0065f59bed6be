"""How far each rule of guidance is from the posterior it stands for, where that is known: a Gaussian prior, value by value.

    python benchmarks/guidance_bias.py

x_0 ~ N(0, 0.1), a render y = 0.5, DDIM and ancestral sampling with 1000 steps from noise level 1e4 to 1e-4, 64 x 64 x 3
values. The posterior of the squared norm is N(m, p^2), 1 / p^2 = 1 / s^2 + gamma, m = p^2 gamma y. That of the unsquared
norm, exp(-gamma |x - y|), concentrates for many values n: the same with gamma / |x - y| in place of gamma, where
|x - y|^2 = n (p^2 + (m - y)^2). Prints, as a table: sample mean minus m over p, sample spread over p, share of steps cut.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.priors.diffusion.guidance import Guidance, Pull
from ia_bench.priors.diffusion.sampler import NoiseSchedule, SamplerSettings, sample

VARIANCE, TARGET, STEPS, SHAPE = 0.1, 0.5, 1000, (1, 3, 64, 64)
CASES = (("variance", "squared"), ("paper", "squared"), ("paper", "l2"))


def posterior(strength: float, norm: str) -> tuple[float, float]:
    """(m, p); for "l2" by iterating the equation for |x - y|, which contracts."""
    gain = strength
    for _ in range(200 if norm == "l2" else 1):
        variance = 1 / (1 / VARIANCE + gain)
        mean = variance * gain * TARGET
        if norm == "l2":
            gain = strength / math.sqrt(math.prod(SHAPE) * (variance + (mean - TARGET) ** 2))
    return mean, math.sqrt(variance)


def main() -> None:
    """Print the table."""
    schedule = NoiseSchedule(1 / (1 + torch.logspace(-4, 4, STEPS, dtype=torch.float64).square()))

    def denoise(noisy: Tensor, t: int) -> Tensor:
        level = float(schedule.alpha_bar[t])
        return VARIANCE * math.sqrt(level) / (VARIANCE * level + 1 - level) * noisy

    print("| rule | norm | gamma | m | p | DDIM: mean | spread | cut | ancestral: mean | spread | cut |")
    print("| :--- | :--- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for rule, norm in CASES:
        for strength in (1.0, 10.0, 100.0, 1000.0):
            mean, spread = posterior(strength, norm)
            cells = [rule, norm, f"{strength:g}", f"{mean:.3f}", f"{spread:.3f}"]
            for eta in (0.0, 1.0):
                guidance = Guidance((Pull(torch.full(SHAPE, TARGET), strength),), rule, norm, VARIANCE)  # type: ignore[arg-type]
                found = sample(guidance.guiding(denoise, schedule), schedule, SHAPE, [0], SamplerSettings(STEPS, eta, clip=None))
                share = guidance.cost["guided_cut"] / guidance.cost["guided_estimates"]
                cells += [f"{(float(found.mean()) - mean) / spread:+.2f}", f"{float(found.std()) / spread:.2f}", f"{share:.0%}"]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
