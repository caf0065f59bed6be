"""``prior=refiner``: a network that was trained on fits and corrects the albedo and the roughness of one."""
