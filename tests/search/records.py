"""Records of searches that are compared, for tests."""

import copy
from typing import Any

from xray_drake.search.record import SearchRecord


def stripped(record: SearchRecord) -> dict[str, Any]:
    """Returns the record without its wall times."""
    data = copy.deepcopy(record.to_dict())
    for action in data["actions"]:
        del action["seconds"]
    return data
