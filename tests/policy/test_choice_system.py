import pytest

from xray_drake.policy.choice_system import valid_options


@pytest.mark.parametrize(
    ("qualities", "valid"),
    [
        ((0.9, 0.2, 0.1), ("a", "b")),  # good enough, at the bound too
        ((0.1, 0.0, 0.05), ("a", "c")),  # none is good: any grasp
        ((0.0, 0.0, 0.0), ()),
    ],
)
def test_what_some_ranking_would_have_grasped(
    qualities: tuple[float, ...], valid: tuple[str, ...]
) -> None:
    assert valid_options("abc", qualities, min_quality=0.2) == valid


def test_without_a_bound_any_grasp_will_do() -> None:
    assert valid_options("ab", (0.0, 0.01), min_quality=0.0) == ("b",)
