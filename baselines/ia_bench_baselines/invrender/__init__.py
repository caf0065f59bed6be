"""InvRender: light as 128 spherical Gaussians, a sparse latent material, visibility of every lobe, indirect light distilled."""
