import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest
from matplotlib.axes import Axes

from xray_drake.drawing.rollout_figures import actions_figure, success_figure

ACTIONS = {
    "random": [7, 9, 9, 10],
    "xray_$a$ (exact)": [2, 3, 3, 4, 6, 1],
    "largest": [],
}
ROLLOUTS = {"random": 9, "xray_$a$ (exact)": 8, "largest": 5}


def heights(panel: Axes) -> list[float]:
    return [patch.get_height() for patch in panel.patches]


def test_a_histogram_for_each_policy() -> None:
    before = mpl.get_backend(auto_select=False)
    figure = actions_figure(ACTIONS, ROLLOUTS, horizon=10)
    assert mpl.get_backend(auto_select=False) == before
    assert [panel.get_title(loc="left") for panel in figure.axes] == [
        "random\n4 of 9, median 9",
        "xray_$a$ (exact)\n6 of 8, median 3",
        "largest\n0 of 5",
    ]
    random, xray, largest = figure.axes
    assert heights(random) == [0, 0, 0, 0, 0, 0, 1, 0, 2, 1]
    assert heights(xray) == [1, 1, 2, 1, 0, 1, 0, 0, 0, 0]
    assert sum(heights(largest)) == 0
    assert [line.get_xdata()[0] for line in xray.lines] == [3]
    assert not largest.lines


def test_many_policies_take_several_rows() -> None:
    numbers = {f"policy {i}": [i + 1] for i in range(6)}
    figure = actions_figure(numbers, dict.fromkeys(numbers, 2), horizon=10)
    drawn = [panel for panel in figure.axes if panel.axison]
    assert len(drawn) == 6
    assert [heights(panel).index(1) for panel in drawn] == [0, 1, 2, 3, 4, 5]


def test_success_against_actions() -> None:
    rates = {"random": [0.1, 0.2, 0.3], "xray": [0.2, 0.5, 0.8]}
    figure = success_figure(rates)
    (axis,) = figure.axes
    lines = {line.get_label(): line for line in axis.lines}
    for name, values in rates.items():
        np.testing.assert_array_equal(lines[name].get_xdata(), [1, 2, 3])
        np.testing.assert_array_equal(lines[name].get_ydata(), values)
    legend = axis.get_legend()
    assert legend is not None
    # The best stands on top, in the colour of its line.
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["xray", "random"]
    first, _ = legend.get_lines()
    assert (first.get_color() == lines["xray"].get_color()).all()


def test_nothing_to_draw() -> None:
    with pytest.raises(ValueError, match="at least one policy"):
        actions_figure({}, {}, horizon=10)
    with pytest.raises(ValueError, match="at least one policy"):
        success_figure({})
