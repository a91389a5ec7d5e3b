"""Timings of one thread, and where they come from in what is saved."""

from collections.abc import Iterator
from typing import Any

import cv2
import pytest
import torch

from xray_drake.provenance import current


@pytest.fixture(autouse=True)
def threads(request: pytest.FixtureRequest) -> Iterator[None]:
    """One, or as many as a module says."""
    count = getattr(request.module, "THREADS", 1)
    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(count)
    cv2.setNumThreads(count)
    yield
    torch.set_num_threads(before[0])
    cv2.setNumThreads(before[1])


def pytest_benchmark_update_json(
    config: object, benchmarks: object, output_json: dict[str, Any]
) -> None:
    output_json["provenance"] = current().to_dict()
    # Whose machine it was is nobody's business.
    output_json["machine_info"].pop("node", None)
