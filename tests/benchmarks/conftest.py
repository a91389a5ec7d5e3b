"""Writes where timings come from into what pytest-benchmark saves."""

from typing import Any

from xray_drake.provenance import current


def pytest_benchmark_update_json(
    config: object, benchmarks: object, output_json: dict[str, Any]
) -> None:
    output_json["provenance"] = current().to_dict()
    # Whose machine it was is nobody's business.
    output_json["machine_info"].pop("node", None)
