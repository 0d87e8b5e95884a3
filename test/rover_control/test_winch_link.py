"""The descent's link to the winch."""

from __future__ import annotations

from msg_schemas.phases import WinchMode
from rover_control.coordination.winch_link import WinchLink, WinchLinkParameters, WinchRequest


def test_a_trim_that_begins_before_the_winch_has_ended_its_motion_renews_the_request():
    link = WinchLink(WinchLinkParameters(), length_tolerance=0.01)
    request = WinchRequest(5.0, 0.1)
    link.on_mode(WinchMode.HOLD, 0.0)
    assert link.step(request, 5.5, 1.0) == request
    link.on_mode(WinchMode.LENGTH, 1.1)
    assert link.step(None, 5.0, 9.0) is None
    assert link.step(None, 5.0, 9.0, trims=True) == request


def test_a_request_is_renewed_until_its_trim_has_timed_out():
    link = WinchLink(WinchLinkParameters(), length_tolerance=0.01)
    request = WinchRequest(2.0, 0.1)
    link.on_mode(WinchMode.HOLD, 0.0)
    link.step(request, 2.0, 1.0)
    link.on_mode(WinchMode.LENGTH, 1.1)
    assert link.step(None, 2.0, 9.0, trims=True) == request
    assert link.step(None, 2.0, 9.3) == request
    assert link.step(None, 2.0, 9.6) is None
