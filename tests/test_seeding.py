"""Streams of random numbers: the same for the same name, else independent."""

import itertools

import numpy as np

from xray_drake.seeding import stream


def test_a_stream_is_the_same_each_time() -> None:
    a, b = (stream(3, "heap", 1).random(4) for _ in range(2))
    np.testing.assert_array_equal(a, b)


def test_no_two_purposes_or_numbers_share_a_stream() -> None:
    """Also where numbers are 0, which NumPy ignores at a seed's end."""
    numbers = [
        n
        for length in range(4)
        for n in itertools.product((0, 1, 2), repeat=length)
    ]
    firsts = {
        float(stream(seed, purpose, *n).random())
        for seed in (0, 1)
        for purpose in ("heap", "objects")
        for n in numbers
    }
    assert len(firsts) == 2 * 2 * len(numbers)


def test_streams_that_heaps_and_records_depend_on_stay() -> None:
    assert stream(1, "objects").integers(2**62) == 2407833284143195448
    assert stream(7, "heap", 1).integers(2**62) == 392872052602347189
    assert stream(7, "sensor", 0, 0, 12).integers(2**62) == 2767642481122867561
