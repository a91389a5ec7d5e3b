import pytest

from xray_drake.policy.choice_system import valid_options


@pytest.mark.parametrize(
    ("qualities", "least", "valid"),
    [
        ((0.9, 0.2, 0.1), 0.2, "ab"),  # good enough, at the bound too
        ((0.1, 0.0, 0.05), 0.2, "ac"),  # none is good: any grasp
        ((0.0, 0.0, 0.0), 0.2, ""),
        ((0.0, 0.01, 0.0), 0.0, "b"),  # without a bound
    ],
)
def test_what_some_ranking_would_have_grasped(
    qualities: tuple[float, ...], least: float, valid: str
) -> None:
    assert valid_options("abc", qualities, min_quality=least) == (*valid,)
