"""nvdiffrecmc on a shared mesh: Monte Carlo shading with a denoiser in the loop."""
