import gc
import weakref
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from xray_drake.occupancy import inference as factory
from xray_drake.training.predictors import predictor


class Inference:
    def infer(self, *images: Any) -> str:
        return "answer"


def test_a_dataset_of_many_sizes_does_not_keep_a_network_for_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Virtual targets are all of different sizes."""
    prepared: list[weakref.ref[Inference]] = []

    def load(path: Path, **settings: Any) -> Inference:
        inference = Inference()
        prepared.append(weakref.ref(inference))
        return inference

    monkeypatch.setattr(factory, "load_inference", load)
    predict: Any = predictor("learned", weights=Path("weights"))
    for size in [*range(100), 99]:
        answer = predict(
            SimpleNamespace(
                target_size=np.full(3, float(size)),
                depth=None,
                target_modal=None,
                camera=None,
                floor=None,
            )
        )
        assert answer == "answer"
    gc.collect()
    assert len(prepared) == 100
    assert sum(reference() is not None for reference in prepared) <= 16
