"""NeILF++ (Zhang et al. 2023) on a shared mesh."""
