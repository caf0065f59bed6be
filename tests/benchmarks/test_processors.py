"""That numbers do not depend on the processor, by benchmarks/processors.py."""

from pathlib import Path

import pytest

from benchmarks.processors import AS_IT_IS, WITHOUT_AVX512, numbers_of


@pytest.mark.slow
@pytest.mark.skipif("avx512f" not in Path("/proc/cpuinfo").read_text(), reason="no AVX-512 here to be left out")
def test_a_run_with_networks_has_the_same_bits_without_avx512(tmp_path: Path) -> None:
    overrides = ["scene=tiny", "preset=smoke", "prior=combined"]
    maps, scores = numbers_of(AS_IT_IS, tmp_path / "as_it_is", overrides)
    others, theirs = numbers_of(WITHOUT_AVX512, tmp_path / "without", overrides)
    assert others == maps
    assert theirs == scores
