"""The published weights of IntrinsicAnything (ECCV 2024): converted once, safely, and sampled as their authors did."""
