"""What priors and methods of inverse rendering are worth, by one protocol: docs/architecture.md says where things are."""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when torch is loaded: its idle threads leave their core to our kernels
