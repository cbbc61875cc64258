"""What mcap_ros2 keeps private is used in one place, under the versions that it was tested with."""

from __future__ import annotations

from types import SimpleNamespace

from proground_log.log.cdr import decoder, encoder
from tests.checkout import ROOT, needs_checkout, pyproject

DEFINITION = "string name\nfloat64[] values\n"


def test_a_message_comes_back_as_it_was() -> None:
    message = SimpleNamespace(name="küche", values=[0.5, -2.0])
    data = encoder("test_msgs/msg/Thing", DEFINITION)(message)
    found = decoder("test_msgs/msg/Thing", DEFINITION)(data)
    assert (found.name, list(found.values)) == (message.name, message.values)


@needs_checkout
def test_private_parts_are_touched_here_alone_and_the_package_is_pinned() -> None:
    touching = [
        path.relative_to(ROOT).as_posix()
        for package in ("pglog", "proground_log", "recorders", "replay")
        for path in sorted((ROOT / package).rglob("*.py"))
        if "mcap_ros2._dynamic" in path.read_text()
    ]
    assert touching == ["proground_log/log/cdr.py"]
    (pin,) = (
        d for d in pyproject()["project"]["dependencies"] if d.startswith("mcap-ros2-support")
    )
    assert "<0.7" in pin
