import pytest

from tests.benchmark.synthetic import record
from xray_drake.benchmark.variants import Variant, variants


def test_each_inference_is_a_variant_once_of_what_looks_at_it() -> None:
    assert variants(
        ["random", "xray", "largest", "xray", "memory"],
        ["geometric", "learned"],
    ) == (
        Variant("random"),
        Variant("xray", "geometric"),
        Variant("xray", "learned"),
        Variant("largest"),
        Variant("memory", "geometric"),
        Variant("memory", "learned"),
    )


def test_the_old_name_of_an_inference_is_the_new_one() -> None:
    found = variants(["xray"], ["exact", "expected", "geometric"])
    assert [v.occupancy for v in found] == ["geometric", "geometric_label"]
    assert Variant.of(record("xray", 0, occupancy="exact")) == found[0]


@pytest.mark.parametrize("policy", ["random", "largest", "oracle"])
def test_blind_policies_are_the_same_under_every_inference(policy: str) -> None:
    one = Variant.of(record(policy, 0, occupancy="geometric"))
    other = Variant.of(record(policy, 0, occupancy="learned"))
    assert one == other == Variant(policy)


def test_the_variant_of_a_record() -> None:
    given = record("xray", 0, occupancy="learned")
    assert Variant.of(given) == Variant("xray", "learned", True)
    given["target_first"] = False
    assert Variant.of(given) == Variant("xray", "learned", False)
    # Records of before the field: the scenarios had it on.
    del given["target_first"]
    assert Variant.of(given).target_first


def test_labels() -> None:
    assert Variant("random").label == "random"
    assert Variant("xray", "geometric").label == "xray (geometric)"
    assert (
        Variant("xray", "geometric", False).label
        == "xray (geometric, target not first)"
    )
    assert Variant("random", "", False).label == "random (target not first)"


def test_the_papers_policies_come_first_and_the_oracle_last() -> None:
    wanted = [
        Variant("random"),
        Variant("largest"),
        Variant("xray", "geometric"),
        Variant("xray", "geometric", False),
        Variant("xray", "learned"),
        Variant("lookahead", "geometric"),
        Variant("memory", "geometric"),
        Variant("oracle"),
    ]
    assert sorted(wanted[::-1], key=lambda v: v.order) == wanted
