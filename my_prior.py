from torch.nn.functional import avg_pool2d

from ia_bench.priors.contract import PriorInfo, Samples


class Retinex:
    """Paint is what is brighter or darker than its surroundings (a box of 31 pixels)."""

    info = PriorInfo(provides=frozenset({"albedo"}))

    def sample(self, observations, *, seed, guidance=None):
        images, masks = observations.images, observations.masks  # (V, H, W, 3) linear, (V, H, W)
        if images.shape != (*masks.shape, 3) or not images.isfinite().all():
            raise ValueError("expected finite images (V, H, W, 3) and masks (V, H, W)")
        around = avg_pool2d(images.mean(-1)[:, None], 31, stride=1, padding=15)[:, 0, :, :, None]
        return Samples({"albedo": (0.3 * images / around.clamp_min(1e-6)).clamp(0, 1)})
