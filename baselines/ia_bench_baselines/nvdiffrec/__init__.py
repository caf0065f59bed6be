"""nvdiffrec on a shared mesh: split-sum shading, without shadows."""
