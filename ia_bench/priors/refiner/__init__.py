"""``prior=refiner``: a network that was trained on fits and corrects the albedo of one."""
