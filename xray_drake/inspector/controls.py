"""Sliders and buttons on a Meshcat page."""

import time
from collections.abc import Callable

from pydrake.geometry import Meshcat


class Controls:
    """Sliders and buttons, and what has been done with them.

    Attributes:
        values: of the sliders, by name.
    """

    def __init__(self, meshcat: Meshcat) -> None:
        """Begins without any; removes those of an earlier page."""
        self._meshcat = meshcat
        self.clear()

    def clear(self) -> None:
        """Removes all of them."""
        self._meshcat.DeleteAddedControls()
        self.values: dict[str, float] = {}
        self._clicks: dict[str, int] = {}

    def add_slider(
        self, name: str, low: float, high: float, grain: float, value: float
    ) -> None:
        """Adds a slider that goes from ``low`` to ``high`` by ``grain``."""
        self.values[name] = self._meshcat.AddSlider(
            name, low, high, grain, value
        )

    def set_slider(self, name: str, value: float) -> None:
        """Moves a slider, as its user would; nothing where there is none."""
        if self.values.get(name, value) != value:
            self.values[name] = self._meshcat.SetSliderValue(name, value)

    def add_button(self, name: str, key: str = "") -> None:
        """Adds a button that a key of the keyboard presses, too."""
        self._meshcat.AddButton(name, key)
        self._clicks[name] = 0

    def delete_button(self, name: str) -> None:
        """Removes a button, if it is there."""
        if self._clicks.pop(name, None) is not None:
            self._meshcat.DeleteButton(name)

    def moved(self) -> dict[str, float]:
        """Returns the values of the sliders moved since the last look."""
        now = {name: self._meshcat.GetSliderValue(name) for name in self.values}
        moved = {
            k: value for k, value in now.items() if value != self.values[k]
        }
        self.values = now
        return moved

    def clicked(self) -> dict[str, int]:
        """Returns how often which buttons were clicked since the last look."""
        now = {
            name: self._meshcat.GetButtonClicks(name) for name in self._clicks
        }
        clicked = {
            name: count - self._clicks[name]
            for name, count in now.items()
            if count != self._clicks[name]
        }
        self._clicks = now
        return clicked

    def serve(self, poll: Callable[[], bool]) -> None:
        """Polls until Ctrl-C, and then removes all controls.

        Args:
            poll: reacts to the controls; False where there was nothing to do.
        """
        try:
            while True:
                if not poll():
                    time.sleep(0.05)
        except KeyboardInterrupt:
            pass
        finally:
            self.clear()
