"""A page of another origin gets nothing of the viewer."""

import time

import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.report.page_origin import is_own_page
from torchgrasp.report.viewer import EpisodeViewer

HERE, EVERYWHERE = "127.0.0.1", "0.0.0.0"


@pytest.mark.parametrize(
    ("origin", "address", "host", "own"),
    [
        (None, "127.0.0.1:8080", HERE, True),  # no browser
        ("http://127.0.0.1:8080", "127.0.0.1:8080", HERE, True),
        ("http://localhost:9000", "localhost:9000", HERE, True),  # forwarded by ssh
        ("http://[::1]:8080", "[::1]:8080", "::1", True),
        ("http://LocalHost:80", "localhost:80", HERE, True),
        ("http://robot.lab:8080", "robot.lab:8080", EVERYWHERE, True),
        ("http://evil.example", "127.0.0.1:8080", HERE, False),
        ("http://localhost:3000", "localhost:8080", HERE, False),  # another server's page
        ("http://evil.example:8080", "evil.example:8080", HERE, False),  # a name made to lead here
        ("null", "127.0.0.1:8080", HERE, False),  # a file, or a frame shut off
        ("", "", HERE, False),
        ("null", None, EVERYWHERE, False),
        ("http://[", "[", EVERYWHERE, False),
        ("http://evil.example", "robot.lab:8080", EVERYWHERE, False),
    ],
)
def test_a_page_is_its_own_by_its_origin(origin, address, host, own):
    assert is_own_page(origin, address, host) is own


@pytest.fixture
def viewer():
    with EpisodeViewer(policies=["<b>bold</b>", "expert"], port=0) as viewer:
        yield viewer


def receive(viewer: EpisodeViewer, origin: str | None) -> bytes | str:
    address = viewer.address.replace("http", "ws")
    protocols = [f"viser-v{viser.__version__}"]
    # The first message holds the robot's meshes, more than this client takes by default.
    with connect(address, subprotocols=protocols, origin=origin, max_size=None) as client:  # pyright: ignore
        return client.recv(timeout=10)


def test_another_page_gets_nothing_and_changes_nothing(viewer):
    assert receive(viewer, None) and receive(viewer, viewer.address)
    for origin in ("http://evil.example", "null"):
        with pytest.raises(ConnectionClosed) as closed:
            receive(viewer, origin)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1008
    assert receive(viewer, viewer.address)


def test_names_are_shown_as_text(viewer):
    name = "<img src=x onerror=alert(1)> ![x](y) **b** \x1b[31m"
    table = SuccessTable()
    table.add(name, True)
    viewer.panel.tell_state(name, "step 1 of 4", 0.5)
    viewer.panel.tell_success(viewer.policy, table)
    assert viewer.panel.target.value == name.replace("\x1b", "\\x1b")
    assert viewer.panel.success.value.startswith("<b>bold</b>: lifted 1 of 1")
    assert isinstance(viewer.panel.target, viser.GuiTextHandle) and viewer.panel.target.disabled
    assert isinstance(viewer.panel.success, viser.GuiTextHandle)
    assert name not in viewer.panel.state.content


def test_what_a_page_cannot_choose_is_not_taken(viewer):
    viewer.panel.policy._impl.value = "nobody"  # as a message sets it
    assert viewer.policy == "<b>bold</b>"
    for speed, longest in ((0.0, 1.0), (float("nan"), 1.0), (-1.0, 1.0)):
        viewer.panel.speed._impl.value = speed
        begun = time.monotonic()
        viewer.panel.wait(0.01)
        assert time.monotonic() - begun < longest
    with pytest.raises(ConfigError, match=r"speed=0\.0"):
        EpisodeViewer(policies=["expert"], port=0, speed=0.0)
