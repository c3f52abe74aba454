"""The controls of the viewer's page, and the time that they rule."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from torchgrasp.errors import printable
from torchgrasp.evaluation.success import SuccessTable

if TYPE_CHECKING:
    import viser

SLOWEST, FASTEST = 0.1, 10.0
# Seconds after which the controls are looked at again.
_TICK = 0.05


class Skipped(Exception):  # noqa: N818 (nothing went wrong)
    """Raised where an episode is watched and the page asks for the next one."""


class ViewerPanel:
    """Words on what happens, and pause, next episode, speed and policy.

    Args:
        server: whose panel is filled.
        policies: names to choose from; the first plays first.
        speed: that playing begins with, times real time.
    """

    def __init__(self, server: viser.ViserServer, *, policies: Sequence[str], speed: float) -> None:
        gui = server.gui
        # Sharing would send the page through a server of other people.
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label("torchgrasp")
        # Names of objects and policies come from outside: text fields show them as they are, Markdown would
        # make elements of the page of them.
        self.target = gui.add_text("Object", "", disabled=True)
        self.state = gui.add_markdown("Preparing the objects, then the first episode.")
        gui.add_markdown("Time left")
        self.time_left = gui.add_progress_bar(100.0)
        self.success = gui.add_text("Success", "No episode is over yet.", multiline=True, disabled=True)
        self.policy = gui.add_dropdown("Policy", list(policies), hint="plays from the next episode on")
        self.speed = gui.add_slider("Speed", SLOWEST, FASTEST, 0.1, speed, hint="times real time")
        self.pause = gui.add_checkbox("Pause", False)
        self.next = gui.add_button("Next episode")
        gui.add_markdown("Blue: points observed. Green: the grasp aimed for. Magenta: the grasp predicted.")
        self._skip = threading.Event()
        self.next.on_click(lambda _: self.skip())
        self._shown = time.monotonic()

    @property
    def chosen_policy(self) -> str:
        """The policy that the page has chosen; the first where a page asks for one that there is not."""
        return self.policy.value if self.policy.value in self.policy.options else self.policy.options[0]

    @property
    def _pace(self) -> float:
        """Times real time; a page may send any number."""
        return min(max(SLOWEST, self.speed.value), FASTEST)

    def skip(self) -> None:
        """Ask for the next episode, from any thread, as the page's button does."""
        self._skip.set()

    def wait(self, seconds: float) -> None:
        """Let `seconds` of an episode pass since the last wait at the chosen speed, and any pause.

        Raises:
            Skipped: where the next episode is asked for.
        """
        while not self._skip.is_set():
            rest = seconds / self._pace - (time.monotonic() - self._shown)
            if rest <= 0 and not self.pause.value:
                self._shown = time.monotonic()
                return
            self._skip.wait(_TICK if self.pause.value else min(_TICK, rest))
        self._skip.clear()
        self._shown = time.monotonic()
        raise Skipped

    def tell_state(self, target: str, text: str, time_left: float) -> None:
        """Say which object is shown, and what happens; `time_left` is the share of the episode's steps."""
        self.target.value, self.state.content = printable(target), text
        self.time_left.value = 100.0 * time_left

    def tell_success(self, policy: str, table: SuccessTable) -> None:
        """Say how often the policy lifted."""
        low, high = table.confidence_interval()
        self.success.value = printable(
            f"{policy}: lifted {table.successes} of {table.episodes}, {table.success_rate:.0%} "
            f"(95 %: {low:.0%} to {high:.0%})"
        )
