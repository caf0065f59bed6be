"""TensoIR (Jin et al. 2023) on a shared mesh."""
