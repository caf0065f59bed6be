"""Spherical Gaussians: light as a sum of smooth lobes, whose integrals with a BRDF have closed forms."""
