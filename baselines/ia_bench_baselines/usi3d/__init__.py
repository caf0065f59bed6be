"""Liu et al. 2020 (USI3D): images, albedos and shadings as three domains, translated without pairs."""
