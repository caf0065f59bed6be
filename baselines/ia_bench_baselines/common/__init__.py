"""What several baselines share: descent in phases, the pixels they are trained on, networks, and maps of what was recovered."""
